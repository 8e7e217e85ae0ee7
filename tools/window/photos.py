"""From a folder of photos to a scene in a real Blender window, by mouse and keys, with pictures.

    python -m tools.window.photos BLENDER --engine-python PYTHON [--out FOLDER] [--photos N]

Needs what `driver` needs. Takes photos of the demo scene, stops and continues once, and measures
how fast the window answers while the engine works. Prints a line per step with its seconds; the
exit status is 1 when a step did not do what it should.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from .afternoon import OURS, SIZE, Afternoon, expect
from .check import gone_after, handled
from .driver import REPOSITORY, Blender, Screen, WindowError, with_extension
from .pictures import select
from .scenario import BUSY, JOB, SCENE, STATE, parser, show_tab

ANSWER_SECONDS, STOP_SECONDS = 1.0, 2.0
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
CUBE, NOTHING = (577, 470), (300, 800)
"""Places in the window."""


def copied(folder: Path, count: int) -> Path:
    """A folder with so many photos of the demo scene."""
    photos = folder / ROOM
    photos.mkdir()
    for path in sorted((SCENE / "images" / "wide").iterdir())[:count]:
        shutil.copyfile(path, photos / path.name)
    return photos


def measured(blender: Blender) -> None:
    """Select and deselect the cube while the engine works; every click must be answered."""
    took = [handled(blender, "selected", place) for place in (NOTHING, CUBE) * 4]
    clock, processor = (
        [round(number, 2) for number in numbers] for numbers in zip(*took, strict=True)
    )
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    print(f"clicks answered after {clock} s, {processor} s of Blender's own; {load}", flush=True)
    expect(max(clock) <= ANSWER_SECONDS, "a click took too long")


def reconstruct(story: Afternoon, photos: Path) -> None:
    """Choose, reconstruct, stop, continue, import."""
    blender = story.blender

    def choose() -> None:
        story.button("roigs.choose_photos")
        blender.choose(photos)
        blender.until(f"{PROPS}.photos == {str(photos)!r}")

    def start() -> None:
        blender.ask(WATCH)
        for place in (NOTHING, CUBE):  # the first time, Blender compiles its shaders
            handled(blender, "selected", place)
        story.button("roigs.reconstruct", 0.4)
        blender.until(f"{BUSY} and {STATE}.stage == 'matching' and {STATE}.step > 20", 300)
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
        blender.until(f"{BUSY} and {STATE}.stage == 'mapping' and {STATE}.step > 4", 300)

    def result() -> None:
        story.until_idle()
        blender.until(f"len({OURS.format('CAMERA')}) > {len(list(photos.iterdir())) // 2}")
        select(blender, "CAMERA")
        story.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")

    def drop() -> None:
        other = photos.with_name(OTHER)
        shutil.copytree(photos, other)
        blender.screen.do("mousemove", *map(str, NOTHING))
        blender.pause(0.5)
        story.ask(DROP.format(folder=str(other), name=min(os.listdir(other))))

    story.step("choose", choose)
    story.step("reconstruct", start)
    story.step("stop", stop)
    story.step("continue", resume)
    story.step("scene", result)
    story.step("drop", drop, mouse=False)
    blender.press("Return")  # the entry under the mouse
    blender.until(f"{PROPS}.photos == {str(photos.with_name(OTHER))!r}")


def main() -> int:
    """Go there."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures" / "photos")
    options.add_argument("--photos", type=int, default=30, help="how many are taken (30)")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        resources = with_extension(given.blender, folder)
        photos = copied(folder, given.photos)
        screen, log = Screen(*SIZE), given.out / "blender.log"
        given.out.mkdir(parents=True, exist_ok=True)
        python = {"ROIGS_ENGINE_PYTHON": os.fspath(given.engine_python)}
        story = None
        try:
            with Blender(given.blender, screen, resources, log=log, variables=python) as blender:
                blender.ask(LOOK)
                show_tab(blender)
                story = Afternoon(blender, folder, given.out)
                reconstruct(story, photos)
        except WindowError as error:
            print(f"step {story.done if story else 0} failed: {error}", file=sys.stderr)
            return 1
        finally:
            screen.close()
    log.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
