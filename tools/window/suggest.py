"""Suggests photos by clicks in a real Blender window, and says how long it takes.

    python -m tools.window.suggest BLENDER --engine-python PYTHON [--out FOLDER]

Needs what `driver` needs. Counted is the time from the import of the demo's 91 photos to the end of
the import, and from the click to the cameras; not how long the pointer looks for its button.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from .driver import Blender
from .scenario import (
    BUSY,
    import_demo,
    load_boxes,
    open_photos_panel,
    parser,
    pictured_failure,
    prepare,
    window,
)

SIZE = (1040, 980)
CAMERAS = "[o.name for o in bpy.data.objects if o.roigs.kind == 'SHOT']"


def suggest(blender: Blender, out: Path) -> None:
    """Import, click, and look through the first suggestion."""
    began = time.monotonic()
    import_demo(blender)
    blender.until(f"not {BUSY}", 120)
    imported = time.monotonic() - began
    load_boxes(blender)
    open_photos_panel(blender, "roigs.suggest_photos", 0.3)
    button = blender.find("roigs.suggest_photos", x=0.3)
    began = time.monotonic()
    blender.click(button)
    blender.until(f"not {BUSY} and {CAMERAS}", 300)
    suggested = time.monotonic() - began
    count = len(blender.ask(CAMERAS))
    print(f"imported in {imported:.1f} s, {count} cameras {suggested:.1f} s after the click")
    blender.click(blender.find("roigs.look_through_suggestion", x=0.83))
    blender.pause(4.0)
    blender.screen.picture(out / "suggestions.png")


def main() -> int:
    """Run the steps, with a picture."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=Path("build/window"))
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with window(given, *SIZE) as blender, pictured_failure(blender, given.out):
        prepare(blender)
        suggest(blender, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
