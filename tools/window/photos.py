"""From a folder of photos to a trained object in a real Blender window, by mouse and keys.

    python -m tools.window.photos BLENDER --engine-python PYTHON [--out FOLDER] [--source FOLDER]

Needs what `driver` needs. Takes photos of the demo scene or of another folder, stops and continues
once, kills Blender in the middle, and measures how fast the window answers while the engine works.
Prints a line per step with its seconds and photographs it; the exit status is 1 when a step did
not do what it should.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from .afternoon import OURS, SIZE, TRAINED, Afternoon, expect
from .check import gone_after, handled
from .driver import REPOSITORY, Blender, Screen, WindowError, with_extension
from .pictures import select
from .scenario import BUSY, JOB, SCENE, STATE, addon, open_photos_panel, parser, show_tab

ANSWER_SECONDS, STOP_SECONDS, ORPHAN_SECONDS = 1.0, 2.0, 5.0
RECONSTRUCTIONS = addon("facts.reconstructions")
LOOK = """
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
bpy.context.preferences.view.smooth_view = 0
bpy.context.preferences.filepaths.use_auto_save_temporary_files = False
"""
ROOM, OTHER = "room", "kitchen"
"""Folders of photos."""
PROPS = "bpy.context.scene.roigs"
DROP = """
with bpy.context.temp_override(**view()):
    bpy.ops.wm.drop_import_file(
        "INVOKE_DEFAULT", directory={folder!r}, files=[{{"name": {name!r}}}])
"""
WATCH = """
def watch(scene, graph=None):
    note("selected")
bpy.app.handlers.depsgraph_update_post.append(watch)
"""
MATCHING = f"{BUSY} and {STATE}.stage == 'matching' and {STATE}.step > {{}}"
KILLED_AT = 120
"""Blender is killed after this number of matched pairs."""
FRAME = ("KP_Decimal", *["KP_Subtract"] * 4)
"""Keys that show the box beside the sidebar."""
CUBE, NOTHING = (577, 470), (300, 800)
"""Places in the window, pixels."""


def copied(folder: Path, source: Path, count: int) -> Path:
    """Copy `count` photos of another folder; 0: all, also those in its subfolders."""
    photos = folder / ROOM
    if not count:
        return Path(shutil.copytree(source, photos))
    photos.mkdir()
    for path in sorted(source.iterdir())[:count]:
        shutil.copyfile(path, photos / path.name)
    return photos


def prepare(blender: Blender) -> None:
    """Click once before `measured`: the first time, Blender compiles its shaders."""
    blender.ask(WATCH)
    for place in (NOTHING, CUBE):
        handled(blender, "selected", place)


def measured(blender: Blender) -> None:
    """Select and deselect the cube while the engine works; every click must be answered."""
    took = [handled(blender, "selected", place) for place in (NOTHING, CUBE) * 4]
    clock, processor = (
        [round(number, 2) for number in numbers] for numbers in zip(*took, strict=True)
    )
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    print(
        f"clicks answered after {clock} s, {processor} s of Blender's own;"
        f" load {load:.1f} on {cores} cores",
        flush=True,
    )
    shared = load > 2 * cores  # other programs also delay Blender
    expect(max(processor if shared else clock) <= ANSWER_SECONDS, "a click took too long")


def begin(story: Afternoon, photos: Path, blend: Path) -> None:
    """Choose, reconstruct, stop, continue, and kill Blender."""
    blender = story.blender

    def choose() -> None:
        story.button("roigs.choose_photos")
        blender.choose(photos)
        blender.until(f"{PROPS}.photos == {str(photos)!r}")

    def start() -> None:
        prepare(blender)
        story.button("roigs.reconstruct", 0.4)
        blender.until(MATCHING.format(20), 900)
        measured(blender)

    def stop() -> None:
        pid = int(story.ask(f"{JOB}.process.pid"))
        blender.screen.do("mousemove", *map(str, NOTHING))
        took = gone_after(pid, blender.press("Escape"))
        print(f"Esc: the engine ended after {took:.2f} s", flush=True)
        expect(took <= STOP_SECONDS, f"stopping took {took:.2f} s")
        story.until_idle()

    def resume() -> None:
        story.button("roigs.reconstruct", 0.4)
        blender.until(MATCHING.format(KILLED_AT), 900)

    story.step("choose", choose)
    story.step("reconstruct", start)
    story.step("stop", stop)
    story.ask(f"bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r}) and None")
    story.step("continue", resume)
    pid, killed = int(story.ask(f"{JOB}.process.pid")), time.time()
    blender.kill()
    took = gone_after(pid, killed)
    print(f"Blender killed: the engine ended after {took:.2f} s", flush=True)
    expect(took <= ORPHAN_SECONDS, f"the engine ended after {took:.2f} s")


def finish(story: Afternoon, photos: Path) -> None:
    """Find the reconstruction again, continue, import."""
    blender = story.blender

    def found() -> None:
        show_tab(blender)
        expect(story.ask(f"{PROPS}.photos == {str(photos)!r}"), "the photos were forgotten")
        status = f"{RECONSTRUCTIONS}.of(bpy.context.scene)[1]"
        expect(story.ask(f"{status}.unfinished"), "the reconstruction was not found again")

    def result() -> None:
        prepare(blender)
        story.button("roigs.reconstruct", 0.4)
        blender.until(f"{BUSY} and {STATE}.stage in ('matching', 'mapping') and {STATE}.step", 600)
        step = story.ask(f"{STATE}.step if {STATE}.stage == 'matching' else 1000")
        expect(step > KILLED_AT, "the matches were lost")
        blender.until(f"{STATE}.stage == 'mapping' and {STATE}.step > 0", 900)
        measured(blender)
        story.until_idle()
        blender.until(f"len({OURS.format('CAMERA')}) > {len(list(photos.iterdir())) // 2}")
        select(blender, "CAMERA")
        story.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")

    story.step("killed", found)
    story.step("scene", result)


def train(story: Afternoon, side: int) -> None:
    """Make a box around the subject, select cameras, train, and look at the result."""
    blender = story.blender

    def box() -> None:
        story.button("roigs.add_roi", 0.3)
        blender.until(f"len({OURS.format('ROI')}) == 1")
        story.keys(*FRAME)

    def select_cameras() -> None:
        open_photos_panel(blender, "roigs.select_cameras", 0.5)
        story.button("roigs.select_cameras")
        story.until_idle()
        blender.until(f"len({OURS.format('ROI')}[0].roigs.selection) > 5")

    def training() -> None:
        story.button("roigs.train_roi", 0.3)
        blender.until(f"{BUSY} and {STATE}.step > 300", 900)

    def result() -> None:
        story.until_idle()
        blender.until(TRAINED)
        story.keys(*FRAME)
        story.ask("setattr(view()['area'].spaces.active.overlay, 'show_overlays', False)")
        blender.pause(5.0)

    story.step("box", box)
    story.step("cameras", select_cameras)
    story.field("max_side", side)
    story.step("train", training)
    story.step("result", result)


def drop(story: Afternoon, photos: Path) -> None:
    """Drop photos from another folder on the view."""
    blender, other = story.blender, photos.with_name(OTHER)

    def dropped() -> None:
        shutil.copytree(photos, other)
        blender.screen.do("mousemove", *map(str, NOTHING))
        blender.pause(0.5)
        story.ask(DROP.format(folder=str(other), name=min(os.listdir(other))))

    story.step("drop", dropped, mouse=False)
    blender.press("Return")  # the entry under the mouse
    blender.until(f"{PROPS}.photos == {str(other)!r}")


def main() -> int:
    """Run all steps."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures" / "photos")
    options.add_argument("--source", type=Path, default=SCENE / "images" / "wide", help="of photos")
    options.add_argument("--photos", type=int, default=30, help="how many are taken; 0: all (30)")
    options.add_argument("--side", type=int, default=240, help="of the photos in training (240)")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        resources = with_extension(given.blender, folder)
        photos = copied(folder, given.source, given.photos)
        screen, log, blend = Screen(*SIZE), given.out / "blender.log", folder / "room.blend"
        given.out.mkdir(parents=True, exist_ok=True)
        python = {"ROIGS_ENGINE_PYTHON": os.fspath(given.engine_python)}
        story = None

        def window(*arguments: str) -> Blender:
            return Blender(
                given.blender, screen, resources, log=log, arguments=arguments, variables=python
            )

        try:
            with window() as blender:
                blender.ask(LOOK)
                show_tab(blender)
                story = Afternoon(blender, folder, given.out)
                begin(story, photos, blend)
            with window(str(blend)) as blender:
                blender.ask(LOOK)
                story.blender = blender
                finish(story, photos)
                train(story, given.side)
                drop(story, photos)
        except WindowError as error:
            print(f"step {story.done if story else 0} failed: {error}", file=sys.stderr)
            return 1
        finally:
            screen.close()
    log.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
