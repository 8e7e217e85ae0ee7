"""Places the demo scene in a real Blender window by clicks, takes it back, and looks at the result.

    python -m tools.window.placement BLENDER --engine-python PYTHON [--pictures FOLDER]

Needs what `driver` needs. Prints one line per check; the exit status is 1 when one failed.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from .driver import Blender
from .scenario import SCENE, addon, parser, prepare, window

FILE = "roigs_placement.json"
BELOW = 34
"""Pixels from the photo's button to the folded panel below it."""
PICKS = addon("viewport.picks")
INSIDE = """
def cloud():
    return next(o for o in bpy.data.objects if o.roigs.kind == "POINTS")
def place(k):
    return cloud().matrix_world @ cloud().data.vertices[k].co
def on_screen(k):
    from bpy_extras.view3d_utils import location_3d_to_region_2d
    region, window = view()["region"], view()["window"]
    at = location_3d_to_region_2d(region, view()["area"].spaces.active.region_3d, place(k))
    return at.x + region.x, window.height - at.y - region.y
def size():
    return bpy.context.scene.roigs.root.matrix_world.to_scale().x
def remember():
    global before
    before = bpy.context.scene.roigs.root.matrix_world.copy()
def heights():
    moved = bpy.context.scene.roigs.root.matrix_world @ before.inverted()
    chosen = bpy.context.window_manager.operators[-1].properties
    return [(moved @ point).z for point in (chosen.first, chosen.second, chosen.third)]
def distance():
    return view()["area"].spaces.active.region_3d.view_distance
def clip():
    return view()["area"].spaces.active.clip_end
"""
failures: list[str] = []


def check(text: str, good: bool) -> None:
    """Print the result of a check; a bad one is also added to `failures`."""
    print(f"{'good' if good else 'BAD '} {text}", flush=True)
    if not good:
        failures.append(text)


def floor_points(blender: Blender) -> list[int]:
    """Three sparse points low in the scene, far apart in the view from above."""
    rows: list[tuple[int, list[float], float]] = blender.ask(
        "[(k, on_screen(k), place(k).z) for k in range(0, len(cloud().data.vertices), 7)]"
    )
    low = sorted(height for _, _, height in rows)[len(rows) // 5]
    seen = [(k, at) for k, at, height in rows if height < low and 150 < at[0] < 800]
    first = min(seen, key=lambda entry: entry[1][0])[0]
    second = max(seen, key=lambda entry: entry[1][0])[0]
    third = max(seen, key=lambda entry: entry[1][1])[0]
    return [first, second, third]


def click_point(blender: Blender, row: int) -> None:
    """Click a sparse point."""
    x, y = blender.ask(f"on_screen({row})")
    blender.screen.do("mousemove", str(round(x) - 2), str(round(y)))
    blender.pause(0.2)
    blender.click((round(x), round(y)))
    blender.pause(0.4)


def picked(blender: Blender) -> Any:
    """The marked points."""
    return blender.ask(f"[tuple(point) for point in {PICKS}.picked]")


def work(blender: Blender, project: Path, pictures: Path | None) -> None:
    """Run all checks."""
    prepare(blender)
    blender.ask(INSIDE)
    blender.ask(f"call('roigs.import_colmap', directory={str(project)!r})", 120)
    blender.ask("call('view3d.view_axis', type='BOTTOM')")
    blender.ask("call('view3d.view_all')")
    blender.ask("bpy.ops.ed.undo_push(message='imported')")
    blender.pause(1.0)
    x, y = blender.find("roigs.look_through")
    blender.click((x, y + BELOW))
    blender.pause(0.5)
    away = blender.ask("distance()")
    rows, file = floor_points(blender), project / FILE

    blender.click(blender.find("roigs.set_scale", x=0.3))
    click_point(blender, rows[0])
    check("one click marks one point", len(picked(blender)) == 1)
    blender.press("BackSpace")
    blender.pause(0.3)
    check("Backspace takes it back", not picked(blender))
    click_point(blender, rows[0])
    if pictures:
        blender.screen.picture(pictures / "picking.png")
    click_point(blender, rows[1])
    blender.pause(0.5)
    check(f"two clicks scale the scene: {blender.ask('size()'):.3f}", blender.ask("size()") != 1)
    check("the file is there", file.is_file())
    clipped, seen = blender.ask("clip() / size()"), blender.ask("distance() / size()")
    check(f"the view follows: clip {clipped:.0f}", abs(clipped - 1000) < 1)
    check(f"the view follows: distance {seen:.2f}, before {away:.2f}", abs(seen / away - 1) < 0.01)
    check("nothing stays marked", not picked(blender))
    text, size = file.read_text(), blender.ask("size()")
    blender.press("ctrl+z")
    blender.pause(1.0)
    check("undo takes back the scale", blender.ask("size()") == 1)
    check("undo takes back the file", not file.exists())
    check("undo takes back the view", abs(blender.ask("clip()") - 1000) < 1)
    check("undo takes back the distance", abs(blender.ask("distance()") / away - 1) < 0.01)
    blender.press("ctrl+shift+z")
    blender.pause(1.0)
    check("redo scales again", abs(blender.ask("size()") - size) < 1e-6)
    check("redo moves the view again", abs(blender.ask("distance()") / size / away - 1) < 0.01)
    check("redo writes the file again", file.is_file() and file.read_text() == text)

    blender.click(blender.find("roigs.set_scale", x=0.3))
    click_point(blender, rows[0])
    click_point(blender, rows[1])
    blender.pause(0.5)
    size = blender.ask("size()")
    blender.ask("bpy.context.window_manager.operators[-1].properties.length = 3.0")
    blender.ask("call('ed.undo_redo')")  # as a change in the F9 panel does
    blender.pause(0.5)
    factor = blender.ask("size()") / size
    check(f"another length scales from where it was: {factor:.3f}", abs(factor - 3) < 1e-3)
    seen = blender.ask("distance() / size()")
    check("the view follows that, too", abs(seen / away - 1) < 0.01)

    blender.ask("remember()")
    blender.click(blender.find("roigs.set_floor"))
    for row in rows:
        click_point(blender, row)
    blender.pause(0.5)
    heights = blender.ask("heights()")
    check("three clicks make a floor", max(map(abs, heights)) < 1e-5)
    if pictures:
        blender.screen.picture(pictures / "placed.png")
    blender.click(blender.find("roigs.set_scale", x=0.3))
    click_point(blender, rows[0])
    blender.press("Escape")
    blender.pause(0.5)
    check("Esc cancels", not picked(blender))
    check("drawing did not fail", not blender.ask(f"{PICKS}._handler.failure"))


def main() -> int:
    """Run the checks; returns the exit status."""
    given = parser(__doc__)
    given.add_argument("--pictures", type=Path, help="folder for two pictures")
    options = given.parse_args()
    with tempfile.TemporaryDirectory() as temporary, window(options, 1400, 900) as blender:
        project = Path(shutil.copytree(SCENE, Path(temporary, "garden")))
        work(blender, project, options.pictures)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
