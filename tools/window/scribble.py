"""Makes masks from strokes by real mouse drags in a real Blender window; makes pictures.

    python -m tools.window.scribble BLENDER --engine-python PYTHON --run FOLDER [--out FOLDER]

Needs what `driver` needs, and a finished run of the demo scene, of which it takes a copy; the masks
are written beside a copy of the demo's photos. The pictures go to docs/pictures.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from .clean_up import IN_WINDOW, SIZE, check
from .driver import REPOSITORY, Blender, WindowError
from .pictures import COLOURS, LOOK
from .scenario import BUSY, SCENE, STATE, addon, parser, prepare, window

PHOTOS = ("vase_00", "vase_03", "vase_05", "vase_07", "vase_09", "vase_10")
FIRST = f"close/{PHOTOS[0]}.jpg"
LINES = [[(388, 225), (357, 175)], [(272, 185), (314, 78)], [(296, 147), (321, 287)]]
AROUND = [
    *((289, 6), (235, 63), (206, 173), (204, 280), (246, 392), (300, 412), (351, 417)),
    *((417, 324), (443, 223), (397, 112), (399, 10), (289, 6)),
]
"""Strokes on the first photo, in its pixels."""

SIDE = 240
"""Of the photos that are trained on; pixels."""

OVERLAY = addon("viewport.photo_overlay")
STROKES = "sum(len(__import__('json').loads(s.strokes)) for s in BOX.roigs.scribbles)"
BOX = "bpy.context.scene.objects['vase']"
MODAL = "[o.bl_idname for o in view()['window'].modal_operators]"
PHOTO = "bpy.context.scene.camera.name"


def strokes(blender: Blender) -> int:
    """How many strokes the box has."""
    return int(blender.ask(STROKES.replace("BOX", BOX)))


def places(blender: Blender, points: list[tuple[int, int]]) -> list[tuple[str, str]]:
    """Where pixels of the photo, of 640 x 428, are on the screen."""
    blender.ask(
        "with bpy.context.temp_override(**view()):\n"
        f"    shown = {OVERLAY}.frame_of(bpy.context)\n"
        "region = view()['region']\n"
        "corner = (region.x, view()['window'].height - region.y)\n"
    )
    left, bottom, right, top = blender.ask("list(shown)")
    x, y = blender.ask("list(corner)")
    found = []
    for across, down in points:
        place = left + across / 640 * (right - left), top - down / 428 * (top - bottom)
        found.append((str(round(x + place[0])), str(round(y - place[1]))))
    return found


def drag(blender: Blender, points: list[tuple[int, int]], *, around: bool = False) -> None:
    """Draw a stroke with the mouse; `around`: with Ctrl."""
    there = places(blender, points)
    before = strokes(blender)
    blender.screen.do("mousemove", *there[0])
    blender.pause(0.3)
    if around:
        blender.screen.do("keydown", "ctrl")
    blender.screen.do("mousedown", "1")
    for place in there:
        blender.screen.do("mousemove", *place)
        blender.pause(0.25)
    blender.screen.do("mouseup", "1")
    if around:
        blender.screen.do("keyup", "ctrl")
    blender.until(f"{STROKES.replace('BOX', BOX)} == {before + 1}", 20)


def begin(blender: Blender) -> None:
    """Click Scribble."""
    blender.screen.do("mousemove", "300", "500")  # the sidebar has changed
    blender.pause(2.0)
    blender.click(blender.find("roigs.scribble", x=0.4))
    blender.until(f"'ROIGS_OT_scribble' in {MODAL}", 20)
    blender.pause(1.5)


def end(blender: Blender) -> None:
    """Press Enter over the view."""
    blender.screen.do("mousemove", "300", "500")
    blender.press("Return")
    blender.until(f"'ROIGS_OT_scribble' not in {MODAL}", 20)


def make(blender: Blender) -> None:
    """Click Make Masks, and wait."""
    blender.pause(2.0)
    blender.click(blender.find("roigs.make_masks", x=0.4))
    blender.until(f"{BUSY}", 30)
    blender.until(f"not {BUSY}", 600)
    check(f"made: {blender.ask(STATE + '.outcome')}", bool(blender.ask(f"{STATE}.outcome")))


def open_panel(blender: Blender) -> None:
    """Open the sub-panel by a click on its header, which is below the button of an empty list."""
    for below in (30, 36, 24, 42):
        x, y = blender.find("roigs.edit_selection", x=0.3)
        blender.click((x, y + below))
        blender.pause(1.0)
        with suppress(WindowError):
            blender.find("roigs.scribble", x=0.4)
            return
    raise WindowError("The panel did not open.")


def story(blender: Blender, masks: Path, shot: Callable[[str], None]) -> None:
    """Scribble, make masks, step through five photos, correct one."""
    open_panel(blender)
    for photo in PHOTOS:
        blender.ask(f"call('roigs.edit_selection', action='ADD', photo='close/{photo}.jpg')")
    blender.ask(f"call('roigs.look_through', photo={FIRST!r})")
    blender.pause(2.0)
    begin(blender)
    for line in LINES:
        drag(blender, line)
    drag(blender, [(20, 20), (60, 20)])
    blender.press("ctrl+z")
    blender.until(f"{STROKES.replace('BOX', BOX)} == {len(LINES)}", 20)
    check("undo took the wrong stroke back", True)
    drag(blender, AROUND, around=True)
    end(blender)
    shot("11-scribble")
    make(blender)
    found = sorted(path.name for path in (masks / "vase/close").glob("*.png"))
    check(f"{len(found)} masks", found == sorted(f"{name}.jpg.png" for name in PHOTOS))
    blender.pause(2.0)
    seen = []
    for number in range(5):
        blender.click(blender.find("step_mask(step=1)", x=0.83))
        blender.pause(3.0)
        seen.append(blender.ask(PHOTO))
        if number == 0:
            shot("12-mask")
    check(f"five photos: {', '.join(seen)}", len(set(seen)) == 5)
    corrected = masks / "vase" / f"{seen[-1].removesuffix('.jpg')}.jpg.png"
    before = corrected.read_bytes() if corrected.is_file() else b""
    begin(blender)
    drag(blender, [(252, 256), (255, 280)])  # the left side of the belly
    end(blender)
    make(blender)
    blender.pause(3.0)
    check("the mask of that photo changed", corrected.read_bytes() != before)
    shot("13-corrected")


def train(blender: Blender, run: Path, shot: Callable[[str], None]) -> None:
    """Train on the masks, and look at the vase without the table under it."""
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    blender.ask(f"bpy.context.scene.roigs.max_side = {SIDE}")
    blender.pause(2.0)
    blender.click(blender.find("active_only=True", x=0.7))
    blender.until(f"{BUSY}", 60)
    blender.until(f"not {BUSY}", 1500)
    check(f"trained: {blender.ask(STATE + '.outcome')}", (run / "rois/vase.ply").is_file())
    stages = sorted(path.parent.name for path in run.glob("*/stage.json"))
    check(f"stages: {', '.join(stages)}", "cutout" in stages)
    blender.until("bpy.data.objects.get('vase Gaussians') is not None", 60)
    blender.ask(
        "for item in bpy.data.objects:\n"
        "    if item.name != 'vase Gaussians' and item.type in ('MESH', 'CAMERA', 'EMPTY'):\n"
        "        item.hide_set(True)\n"
        "call('view3d.view_all')\n"
    )
    blender.pause(5.0)
    shot("14-alone")


def main() -> int:
    """Do it, with pictures."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, help="a finished run of the demo")
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary, window(given, *SIZE) as blender:
        folder = Path(temporary)
        scene = shutil.copytree(SCENE, folder / "scene")
        run = folder / "run"
        run.mkdir()
        shutil.copy(given.run / "result.ply", run)

        def shot(name: str) -> None:
            blender.screen.do("mousemove", "3", "450")
            blender.pause(2.0)
            blender.screen.picture(given.out / f"{name}.png", "1040x958+0+0", *COLOURS)

        try:
            prepare(blender)
            blender.ask(LOOK + IN_WINDOW)
            blender.ask(f"call('roigs.import_colmap', directory={str(scene)!r})")
            blender.ask(f"call('roigs.load_rois', filepath={str(scene / 'rois.json')!r})")
            blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
            blender.ask(f"bpy.context.scene.roigs.active_roi = {BOX}")
            blender.pause(2.0)
            story(blender, scene / "masks", shot)
            train(blender, folder / "trained", shot)
        except Exception:
            blender.screen.picture(given.out / "failed.png")
            raise
    return 0


if __name__ == "__main__":
    sys.exit(main())
