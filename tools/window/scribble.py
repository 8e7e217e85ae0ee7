"""Makes masks from strokes by real mouse drags in a real Blender window; makes pictures.

    python -m tools.window.scribble BLENDER --engine-python PYTHON --run FOLDER [--out FOLDER]
        [--scene FOLDER --box NAME --scribbles FILE --photo NAME ...]

Needs what `driver` needs, and a finished run of the scene, of which it takes a copy; the masks are
written beside a copy of the scene's photos. The pictures go to docs/pictures. Without --scene, it
is the demo. FILE has two scribbles of the box, as for `masks`: the strokes to begin with, and those
that correct the mask of another photo.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from roigs_engine.formats.scribbles import BACKGROUND, Scribble, read_scribbles

from .clean_up import IN_WINDOW, SIZE, check
from .driver import REPOSITORY, Blender, WindowError
from .pictures import COLOURS, LOOK
from .scenario import (
    BUSY,
    SCENE,
    STATE,
    addon,
    open_photos_panel,
    parser,
    pictured_failure,
    prepare,
    window,
)

DEMO = Path(__file__).with_name("scribbles.json")
"""Strokes on photos of the demo."""
DEMO_PHOTOS = tuple(f"close/vase_{number:02}.jpg" for number in (0, 3, 5, 7, 9, 10))

WAIT = 3600
"""Seconds allowed for the training."""

OVERLAY = addon("viewport.photo_overlay")
STROKES = "sum(len(__import__('json').loads(s.strokes)) for s in BOX.roigs.scribbles)"
BOX = "bpy.context.scene.roigs.active_roi"
MODAL = "[o.bl_idname for o in view()['window'].modal_operators]"
PHOTO = "bpy.context.scene.camera.name"


@dataclass(frozen=True, kw_only=True)
class Story:
    """The actions of the story.

    Attributes:
        scene: a copy of the scene's folder, with `images` and `rois.json`.
        box: name of the box.
        photos: the photos that get masks.
        first: the first strokes, on one of these photos.
        correction: strokes on another of these photos.
    """

    scene: Path
    box: str
    photos: tuple[str, ...]
    first: Scribble
    correction: Scribble

    @classmethod
    def of(cls, given: argparse.Namespace, scene: Path) -> Story:
        """The story for the command line's options."""
        found = [each for each in read_scribbles(given.scribbles) if each.box == given.box]
        if len(found) != 2:
            raise SystemExit(f"{given.scribbles} needs two scribbles of box '{given.box}'.")
        drawn = [each.photo for each in found]
        photos = tuple(dict.fromkeys([*drawn, *given.photo]))
        return cls(scene=scene, box=given.box, photos=photos, first=found[0], correction=found[1])

    def size(self, photo: str) -> tuple[int, int]:
        """Width and height of a photo."""
        with Image.open(self.scene / "images" / photo) as image:
            return image.size


def strokes(blender: Blender) -> int:
    """Number of strokes of the box."""
    return int(blender.ask(STROKES.replace("BOX", BOX)))


def places(
    blender: Blender, size: tuple[int, int], points: NDArray[np.float64]
) -> list[tuple[str, str]]:
    """The places on the screen of pixels of a photo of this size."""
    blender.ask(
        "with bpy.context.temp_override(**view()):\n"
        f"    shown = {OVERLAY}.frame_of(bpy.context)\n"
        "region = view()['region']\n"
        "corner = (region.x, view()['window'].height - region.y)\n"
    )
    left, bottom, right, top = blender.ask("list(shown)")
    x, y = blender.ask("list(corner)")
    found = []
    for across, down in points / size:
        place = left + across * (right - left), top - down * (top - bottom)
        found.append((str(round(x + place[0])), str(round(y - place[1]))))
    return found


def drag(
    blender: Blender, size: tuple[int, int], points: NDArray[np.float64], *, around: bool = False
) -> None:
    """Draw a stroke with the mouse; `around`: with Ctrl."""
    there = places(blender, size, points)
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
    blender.until(f"{STROKES.replace('BOX', BOX)} == {before + 1}", 20)
    if around:  # only now: a busy Blender reads the held keys when it handles the press
        blender.screen.do("keyup", "ctrl")


def draw(blender: Blender, story: Story, scribble: Scribble) -> None:
    """Draw all strokes of a scribble on the photo in the view."""
    for stroke in scribble.strokes:
        around = stroke.kind == BACKGROUND
        drag(blender, story.size(scribble.photo), stroke.points, around=around)


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


def play(blender: Blender, story: Story, shot: Callable[[str], None]) -> None:
    """Scribble, make masks, step through all photos, correct one."""
    masks = story.scene / "masks" / story.box
    open_photos_panel(blender, "roigs.scribble", 0.4)
    for photo in story.photos:
        blender.ask(f"call('roigs.edit_selection', action='ADD', photo={photo!r})")
    blender.ask(f"call('roigs.look_through', photo={story.first.photo!r})")
    blender.pause(2.0)
    begin(blender)
    draw(blender, story, replace(story.first, strokes=story.first.strokes[:1]))
    drag(blender, (100, 100), np.array([[3.0, 5.0], [9.0, 5.0]]))
    blender.press("ctrl+z")
    blender.until(f"{STROKES.replace('BOX', BOX)} == 1", 20)
    check("undo took the wrong stroke back", True)
    draw(blender, story, replace(story.first, strokes=story.first.strokes[1:]))
    end(blender)
    shot("11-scribble")
    make(blender)
    found = sorted(path.relative_to(masks).as_posix() for path in masks.rglob("*.png"))
    check(f"{len(found)} masks", found == sorted(f"{photo}.png" for photo in story.photos))
    blender.pause(2.0)
    seen = []
    for number in range(len(story.photos) - 1):
        step(blender)
        seen.append(blender.ask(PHOTO))
        if number == 0:
            shot("12-mask")
    check(f"{len(seen)} photos: {', '.join(seen)}", len(set(seen)) == len(seen))
    blender.ask(f"call('roigs.look_through', photo={story.correction.photo!r})")
    blender.pause(3.0)
    corrected = masks / f"{story.correction.photo}.png"
    before = corrected.read_bytes()
    shot("12-wrong")
    begin(blender)
    draw(blender, story, story.correction)
    end(blender)
    make(blender)
    blender.pause(3.0)
    check("the mask of that photo changed", corrected.read_bytes() != before)
    shot("13-corrected")


def step(blender: Blender) -> None:
    """Click the arrow to the next mask."""
    blender.click(blender.find("step_mask(step=1)", x=0.83))
    blender.pause(3.0)


def train(blender: Blender, box: str, side: int, run: Path, shot: Callable[[str], None]) -> None:
    """Train with the masks, and look at the object without its support."""
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    blender.ask(f"bpy.context.scene.roigs.max_side = {side}")
    blender.pause(2.0)
    try:
        button = blender.find("active_only=True", x=0.7)
    except WindowError:  # there is one box
        button = blender.find("roigs.train_roi", x=0.3)
    blender.click(button)
    blender.until(f"{BUSY}", 60)
    blender.until(f"not {BUSY}", WAIT)
    part = run / "rois" / f"{box}.ply"
    check(f"trained: {blender.ask(STATE + '.outcome')}", part.is_file())
    stages = sorted(path.parent.name.rpartition("-")[0] for path in run.glob("stages/*/stage.json"))
    check(f"stages: {', '.join(stages)}", "cutout" in stages)
    name = f"{box} Gaussians"
    blender.until(f"bpy.data.objects.get({name!r}) is not None", 60)
    blender.ask(
        "for item in bpy.data.objects:\n"
        f"    if item.name != {name!r} and item.type in ('MESH', 'CAMERA', 'EMPTY'):\n"
        "        item.hide_set(True)\n"
        "call('view3d.view_all')\n"
    )
    blender.pause(5.0)
    shot("14-alone")
    for number, axis in enumerate(("FRONT", "RIGHT", "BACK", "TOP")):
        blender.ask(f"call('view3d.view_axis', type={axis!r})")
        blender.ask("call('view3d.view_all')")
        blender.pause(5.0)
        shot(f"14-alone-{number + 1}")


def options() -> argparse.ArgumentParser:
    """Parse the command line."""
    made = parser(__doc__)
    made.add_argument("--run", type=Path, required=True, help="a finished run of the scene")
    made.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures")
    made.add_argument("--scene", type=Path, default=SCENE, help="with sparse, images, rois.json")
    made.add_argument("--box", default="vase")
    made.add_argument("--scribbles", type=Path, default=DEMO, metavar="FILE")
    made.add_argument("--photo", action="append", metavar="NAME", help="one more that gets a mask")
    made.add_argument("--side", type=int, default=240, help="of the photos in training; pixels")
    return made


def main() -> int:
    """Run the story, with pictures."""
    given = options().parse_args()
    if given.photo is None:
        given.photo = DEMO_PHOTOS if given.scribbles == DEMO else ()
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary, window(given, *SIZE) as blender:
        folder = Path(temporary)
        scene = shutil.copytree(given.scene, folder / "scene")
        story = Story.of(given, scene)
        run = folder / "run"
        run.mkdir()
        shutil.copy(given.run / "result.ply", run)

        def shot(name: str) -> None:
            blender.screen.do("mousemove", "3", "450")
            blender.pause(2.0)
            blender.screen.picture(given.out / f"{name}.png", "1040x958+0+0", *COLOURS)

        with pictured_failure(blender, given.out):
            prepare(blender)
            blender.ask(LOOK + IN_WINDOW)
            blender.ask(f"call('roigs.import_colmap', directory={str(scene)!r})")
            blender.ask(f"call('roigs.load_rois', filepath={str(scene / 'rois.json')!r})")
            blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
            blender.ask(f"bpy.context.scene.roigs.active_roi = bpy.data.objects[{story.box!r}]")
            blender.pause(2.0)
            play(blender, story, shot)
            train(blender, story.box, given.side, folder / "trained", shot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
