"""Imports, cleans up and exports Gaussians by clicks in a real Blender window; makes pictures.

    python -m tools.window.clean_up BLENDER --engine-python PYTHON --run FOLDER [--out FOLDER]

Needs what `driver` needs, and a finished run of the demo scene, of which it takes a copy. The
pictures go to docs/pictures.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from .driver import REPOSITORY, Blender, WindowError
from .pictures import COLOURS, LOOK, look_at_boxes
from .scenario import (
    BUSY,
    STATE,
    import_demo,
    load_boxes,
    open_result_panel,
    parser,
    pictured_failure,
    prepare,
    window,
)

SIZE = (1040, 980)
CLOSE = "close/vase_02.jpg"
"""A photo of the vase."""

WIDE = "wide/wide_020.jpg"
"""A photo of the table with vase and tin."""

SELECT, DELETE = 0.55, 0.8
"""Places of a tool's two buttons, as shares of the sidebar's width."""

IN_WINDOW = "bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'"

COUNT = (
    "sum(len(o.data.vertices) for o in bpy.context.scene.objects"
    " if o.roigs.kind == 'SPLATS' and o.visible_get())"
)
CHOSEN = (
    "sum(v.select for o in bpy.context.scene.objects"
    " if o.roigs.kind == 'SPLATS' and o.visible_get() for v in o.data.vertices)"
)


def check(text: str, good: bool) -> None:
    """Print the result of a check; WindowError: it is bad."""
    print(f"{'good' if good else 'BAD '} {text}", flush=True)
    if not good:
        raise WindowError(text)


def clean_up(blender: Blender, picture: Callable[..., None]) -> None:
    """Select by floaters and boxes, delete, erase, undo."""
    whole = blender.ask(COUNT)
    blender.click(blender.find("roigs.find_floaters", x=SELECT))
    blender.until(f"{BUSY}", 180)
    blender.until(f"not {BUSY}", 600)
    blender.pause(2.0)
    check(f"floaters: {blender.ask(STATE + '.outcome')}", bool(blender.ask(f"{STATE}.outcome")))
    floating = blender.ask(CHOSEN)
    blender.ask("call('roigs.look_through', photo=CLOSE)".replace("CLOSE", repr(CLOSE)))
    blender.ask("bpy.context.scene.camera.data.show_background_images = False")
    blender.pause(3.0)
    blender.click(blender.find("where='INSIDE'", x=SELECT))
    blender.until(f"{CHOSEN} not in (0, {floating})", 180)
    blender.pause(4.0)
    check(f"in the active box: {blender.ask(CHOSEN):,} of {whole:,}", True)
    picture("7-clean-up")
    blender.ask("call('view3d.view_camera')")
    look_at_boxes(blender)
    blender.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")
    inside = blender.ask(CHOSEN)
    blender.click(blender.find("where='OUTSIDE'", x=SELECT))
    blender.until(f"{CHOSEN} not in (0, {inside})", 180)
    chosen = blender.ask(CHOSEN)
    check(f"outside the boxes: {chosen:,} of {whole:,}", inside < chosen < whole)
    blender.click(blender.find("roigs.delete_chosen", x=0.4))
    blender.pause(3.0)
    left = blender.ask(COUNT)
    check(f"deleted: {left:,} are left", left == whole - chosen)
    blender.click(blender.find("roigs.erase_brush", x=DELETE))
    blender.until(
        "'ROIGS_OT_erase_brush' in [o.bl_idname for o in view()['window'].modal_operators]"
    )
    brush(blender, "mousedown")
    picture("8-brush", (340, 520))
    blender.screen.do("mouseup", "1")
    with suppress(WindowError):  # checked below
        blender.until(f"{COUNT} < {left}", 60)
    erased = left - blender.ask(COUNT)
    check(f"the brush erased {erased:,}", erased > 0)
    blender.press("Escape")
    blender.press("ctrl+z")
    blender.until(f"{COUNT} == {left}", 20)
    check("undo brought them back", True)


def confidence(blender: Blender, picture: Callable[..., None]) -> None:
    """Measure confidence from the photos, look at the heat map, switch it off."""
    blender.click(blender.find("roigs.find_confidence", x=0.2))
    blender.until(f"{BUSY}", 180)
    blender.until(f"not {BUSY}", 600)
    blender.pause(6.0)
    said = blender.ask(STATE + ".outcome")
    check(f"confidence: {said}", "directions" in str(said))
    blender.ask("call('roigs.look_through', photo=WIDE)".replace("WIDE", repr(WIDE)))
    blender.ask("bpy.context.scene.camera.data.show_background_images = False")
    blender.pause(4.0)
    picture("18-confidence")
    blender.click(blender.find("roigs.show_heat_map", x=0.8))
    blender.pause(3.0)
    blender.ask("call('view3d.view_camera')")
    look_at_boxes(blender)


def brush(blender: Blender, button: str) -> None:
    """Begin a stroke over the middle of the view."""
    blender.screen.do("mousemove", "290", "540")
    blender.pause(0.5)
    blender.screen.do(button, "1")
    for x in range(290, 320, 5):
        blender.screen.do("mousemove", str(x), str(540 + (x - 290)))
        blender.pause(0.1)


def leave_and_return(blender: Blender, folder: Path, picture: Callable[..., None]) -> None:
    """Export as SPZ, then import the file into an empty scene."""
    path = folder / "objects.spz"
    blender.click(blender.find("roigs.export_gaussians", x=0.8))
    blender.until("file_browser() is not None")
    blender.pause(1.5)
    blender.screen.do("mousemove", "960", "76", "click", "1")  # the list of formats
    blender.pause(1.0)
    picture("9-export", None, "340x330+700+0")
    blender.press("Escape")
    blender.choose(path)
    blender.until(f"not {BUSY}", 120)
    check(f"exported {path.stat().st_size / 1e6:.1f} MB", path.is_file())
    blender.ask("bpy.ops.wm.read_homefile(app_template='')")
    blender.pause(2.0)
    prepare(blender)
    blender.ask(LOOK + IN_WINDOW)
    blender.click(blender.find("roigs.import_gaussians", x=0.2))
    blender.until("file_browser() is not None")
    blender.pause(1.5)
    blender.choose(path)
    blender.until(f"not {BUSY}", 120)
    blender.until(f"{COUNT} > 0", 20)
    blender.ask("[o.select_set(True) for o in bpy.context.scene.objects] and None")
    blender.ask("call('view3d.view_axis', type='FRONT')")
    blender.ask("call('view3d.view_selected')")
    blender.pause(8.0)
    picture("10-import")
    check(f"imported {blender.ask(COUNT):,}", True)


def main() -> int:
    """Run the checks, with pictures."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, help="a finished run of the demo")
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary, window(given, *SIZE) as blender:
        folder = Path(temporary)
        run = shutil.copytree(given.run, folder / "run", symlinks=True)

        def picture(
            name: str, mouse: tuple[int, int] | None = (3, 450), crop: str = "1040x958+0+0"
        ) -> None:
            if mouse is not None and mouse[0] == 3:
                blender.screen.do("mousemove", *(str(side) for side in mouse))
            blender.pause(2.0)
            blender.screen.picture(given.out / f"{name}.png", crop, *COLOURS)

        with pictured_failure(blender, given.out):
            prepare(blender)
            blender.ask(LOOK + IN_WINDOW)
            import_demo(blender)
            load_boxes(blender)
            look_at_boxes(blender)
            blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
            blender.ask("call('roigs.load_results')")
            blender.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")
            blender.pause(5.0)
            open_result_panel(blender, "roigs.choose_by_box", x=SELECT)
            confidence(blender, picture)
            clean_up(blender, picture)
            leave_and_return(blender, folder, picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
