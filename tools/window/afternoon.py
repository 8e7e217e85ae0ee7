"""A newcomer's afternoon in a real Blender window: fifteen steps by mouse and keys, with pictures.

    python -m tools.window.afternoon BLENDER --engine-python PYTHON [--out FOLDER] [--side PX]

Needs what `driver` needs. Begins with the factory settings and their start file. Prints a line per
step with its seconds; the exit status is 1 when a step did not do what it should. Paths are given
to the file browser as if they had been typed; everything else is clicked or pressed.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .driver import REPOSITORY, Blender, Screen, WindowError, built_extension
from .scenario import BUSY, SCENE, STATE, addon, open_photos_panel, parser, show_tab

SIZE = (1400, 1000)
COLOURS = ("+dither", "-colors", "96")
PICTURE_SIDE = ("-resize", "800x")
VASE = "vase"
MONKEY = (-0.45, 0.05, 0.85)
"""Place of the mesh: the vase's former place."""
FRAMES = 3

BEGIN = """
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
bpy.context.preferences.view.smooth_view = 0
bpy.context.preferences.filepaths.use_auto_save_temporary_files = False
bpy.context.preferences.system.use_online_access = False
"""
INSTALL = """
keys = manager().keyconfigs.addon.keymaps.new("Window")
keys.keymap_items.new("extensions.package_install_files", "F8", "PRESS")
"""
"""A key for Preferences > Get Extensions > Install from Disk."""
VIEWPORT_RENDER = "Viewport Render with Gaussians"
OURS = "[o for o in bpy.context.scene.objects if o.roigs.kind == {!r}]"
FACTS = addon("facts.run_facts")
TRAINED = f"{FACTS}.run(bpy.context.scene).result"


class Afternoon:
    """The steps, one after the other, first in one window, then in a second one."""

    def __init__(self, blender: Blender, folder: Path, out: Path) -> None:
        """Args: `folder`: for all files that are made; `out`: for the pictures."""
        self.blender, self.folder, self.out = blender, folder, out
        self.done = 0

    def step(self, name: str, work: Callable[[], None], *, mouse: bool = True) -> None:
        """Do a step, time it, and take a picture of the window after it."""
        self.done += 1
        start = time.monotonic()
        try:
            work()
        except WindowError:
            self.blender.screen.picture(self.out / "failed.png")
            raise
        seconds = time.monotonic() - start
        if mouse:
            self.blender.screen.do("mousemove", "3", "500")
        self.blender.pause(3.0)
        name = f"{self.done:02d}-{name}"
        self.blender.screen.picture(self.out / f"{name}.png", "", *PICTURE_SIDE, *COLOURS)
        print(f"{name:<24}{seconds:7.1f} s", flush=True)

    def keys(self, *keys: str) -> None:
        """Press keys over the 3D view, one after the other."""
        self.blender.screen.do("mousemove", str(SIZE[0] // 3), str(SIZE[1] // 3))
        self.blender.pause(0.3)
        for key in keys:
            self.blender.press(key)
            self.blender.pause(0.4)

    def save(self) -> None:
        """Save the file."""
        self.keys("ctrl+s")
        self.blender.until("not bpy.data.is_dirty")

    def close_render(self) -> None:
        """Close the render's window with Escape, and return to the 3D view."""
        where = self.blender.screen.place_of("Render").split("+")
        width, height = map(int, where[0].split("x"))
        centre = int(where[1]) + width // 2, int(where[2]) + height // 2
        self.blender.screen.do("mousemove", *map(str, centre))
        self.blender.pause(0.5)
        self.blender.press("Escape")
        self.blender.until("len(manager().windows) == 1")

    def typed(self, *words: str) -> None:
        """Type a transform: a key, an axis, a number and Enter."""
        *keys, number = words
        self.keys(*keys)
        self.blender.type(number)
        self.keys("Return")

    def button(self, command: str, x: float = 0.5) -> None:
        """Click a button of the sidebar."""
        self.blender.click(self.blender.find(command, x))

    def field(self, name: str, value: int) -> None:
        """Type a number into a field of the sidebar."""
        x, y = self.blender.find(name, 0.7)
        self.blender.screen.do("mousemove", str(x), str(y), "click", "--repeat", "2", "1")
        self.blender.pause(0.5)
        self.blender.press("ctrl+a")
        self.blender.type(str(value))
        self.blender.press("Return")
        self.blender.until(f"bpy.context.scene.roigs.{name} == {value}")

    def until_idle(self) -> None:
        """Wait until the engine has ended; WindowError: it had an error."""
        self.blender.until(f"not {BUSY}", 3600)
        error = self.blender.ask(f"{STATE}.error")
        if error:
            raise WindowError(str(error))

    def ask(self, code: str) -> Any:
        """Evaluate an expression inside Blender."""
        return self.blender.ask(code)


def expect(good: object, text: str) -> None:
    """Raise WindowError with a text unless a value is true."""
    if not good:
        raise WindowError(text)


def before_training(story: Afternoon, archive: Path, side: int) -> None:
    """Install, import, box, select, exclude a photo."""
    blender = story.blender

    def install() -> None:
        story.ask(INSTALL)
        story.keys("Escape", "F8")
        blender.choose(archive)
        blender.until("hasattr(bpy.types.Scene, 'roigs')", 120)
        show_tab(blender)

    def import_model() -> None:
        story.button("roigs.import_colmap")
        blender.choose(SCENE)
        story.until_idle()
        blender.until(f"len({OURS.format('CAMERA')}) > 80")

    def box() -> None:
        story.button("roigs.add_roi")
        blender.until(f"len({OURS.format('ROI')}) == 1")
        item = f"{OURS.format('ROI')}[0]"
        records = json.loads((SCENE / "rois.json").read_text(encoding="utf-8"))["rois"]
        wanted = next(record for record in records if record["name"] == VASE)
        for k, axis in enumerate("xyz"):  # by eye, a person would do the same
            low, high = wanted["min"][k], wanted["max"][k]
            at, half = (
                f"{item}.matrix_world.translation[{k}]",
                f"{item}.matrix_world.to_scale()[{k}]",
            )
            centre, side = (low + high) / 2, (high - low) / 2
            story.typed("g", axis, f"{centre - story.ask(at):.4f}")
            blender.until(f"abs({at} - {centre}) < 1e-3")
            story.typed("s", axis, f"{side / story.ask(half):.4f}")
            blender.until(f"abs({half} - {side}) < 1e-3")
        story.keys("F2", "ctrl+a")
        blender.type(VASE)
        story.keys("Return", "KP_Decimal", "KP_Subtract", "KP_Subtract")
        expect(story.ask(f"{item}.name == {VASE!r}"), "the box has another name")

    def select() -> None:
        open_photos_panel(blender, "roigs.select_cameras", 0.5)
        story.button("roigs.select_cameras")
        story.until_idle()
        blender.until(f"len(bpy.data.objects[{VASE!r}].roigs.selection) > 5")

    def exclude() -> None:
        story.button("roigs.exclude_photos", 0.84)
        blender.until("len(bpy.context.scene.roigs.excluded) == 1")

    story.step("install", install)
    story.step("import", import_model)
    story.step("box", box)
    story.step("select", select)
    story.step("exclude", exclude)
    story.field("max_side", side)


def training(story: Afternoon) -> None:
    """Train, stop, continue, look."""
    blender = story.blender

    def train() -> None:
        story.button("roigs.train_roi", 0.3)
        blender.until(f"{BUSY} and {STATE}.step > 300", 900)

    def stop() -> None:
        story.keys("Escape")
        story.until_idle()

    def resume() -> None:
        story.button("roigs.train_roi", 0.3)
        blender.until(f"{BUSY} and {STATE}.step > 0", 120)
        story.until_idle()
        blender.until(TRAINED)

    def look() -> None:
        story.button("photo=", 0.62)
        blender.until("view()['area'].spaces.active.region_3d.view_perspective == 'CAMERA'")

    story.step("train", train)
    story.step("stop", stop)
    story.step("continue", resume)
    story.step("look", look)


def artwork(story: Afternoon) -> None:
    """Move the vase, put a mesh beside it, F12, an animation."""
    blender = story.blender
    name = f"{VASE} Gaussians"
    vase = f"bpy.data.objects[{name!r}]"
    renders = story.folder / "renders"

    def move() -> None:
        place = f"{vase}.matrix_world.translation[1]"
        before = story.ask(place)
        story.button(f'name="{name}"', 0.2)
        story.typed("g", "y", "0.25")
        blender.until(f"abs({place} - {before} - 0.25) < 1e-3")

    def mesh() -> None:
        story.keys("shift+a")
        blender.type("monkey")
        blender.pause(0.5)
        story.keys("Return")
        blender.until("'Suzanne' in bpy.data.objects")
        story.typed("s", "0.1")
        blender.until("bpy.data.objects['Suzanne'].scale[0] < 0.2")
        for k, wanted in enumerate(MONKEY):
            at = f"bpy.data.objects['Suzanne'].location[{k}]"
            story.typed("g", "xyz"[k], f"{wanted - story.ask(at):.4f}")
            blender.until(f"abs({at} - {wanted}) < 1e-3")

    def f12() -> None:
        story.keys("F12")
        rendering = "bpy.app.is_job_running('RENDER')"
        blender.until(rendering, 20)
        blender.until(f"not {rendering}", 600)

    def viewport_render() -> None:
        """Not a step: **View ▸ Viewport Render Image with Gaussians** has them."""
        story.ask(f"pixels = lambda: list(bpy.data.images[{VIEWPORT_RENDER!r}].pixels)")
        story.ask("call('roigs.render_viewport')")
        story.ask("seen = pixels()")
        story.ask(f"[o.hide_set(True) for o in {OURS.format('SPLATS')}] and None")
        story.ask("call('roigs.render_viewport')")
        changed = story.ask("sum(abs(a - b) > 0.1 for a, b in zip(seen, pixels())) / len(seen)")
        story.ask(f"[o.hide_set(False) for o in {OURS.format('SPLATS')}] and None")
        expect(changed > 0.2, f"the viewport's render has no Gaussians: {changed}")

    def animation() -> None:
        blender.screen.do("mousemove", "3", "500")
        story.ask(f"setattr(bpy.context.scene.render, 'filepath', {str(renders / 'pot')!r})")
        story.ask(f"setattr(bpy.context.scene, 'frame_end', {FRAMES})")
        monkey = "bpy.data.objects['Suzanne']"
        story.keys("i")
        blender.until(f"{monkey}.animation_data is not None")
        story.keys("shift+Right")
        blender.until(f"bpy.context.scene.frame_current == {FRAMES}")
        story.typed("g", "y", "-0.3")
        blender.until(f"{monkey}.location[1] < {MONKEY[1] - 0.2}")
        story.keys("i")
        story.keys("ctrl+F12")
        blender.until(f"__import__('pathlib').Path({str(renders)!r}).is_dir()", 120)
        blender.until("not bpy.app.is_job_running('RENDER')", 1200)
        made = sorted(path.name for path in renders.iterdir())
        expect(len(made) == FRAMES, f"frames: {made}")

    story.step("move", move)
    story.step("mesh", mesh)
    story.step("f12", f12, mouse=False)
    story.close_render()
    viewport_render()
    story.close_render()
    story.step("animation", animation, mouse=False)
    story.close_render()


def second_training(story: Afternoon, side: int) -> None:
    """Train once more at another size; the first result stays in the list."""
    blender = story.blender

    def again() -> None:
        story.field("max_side", side)
        story.button("roigs.train_roi", 0.3)
        blender.until(f"{BUSY} and {STATE}.step > 0", 300)
        story.until_idle()
        earlier = f"{FACTS}.earlier(bpy.context.scene)"
        blender.until(f"len({earlier}) == 1", 30)
        blender.scroll(40)

    story.step("second-training", again)
    story.save()
    blender.quit()


def next_day(story: Afternoon) -> None:
    """Reopen the file: everything is there."""
    blender = story.blender

    def reopen() -> None:
        show_tab(blender)
        expect(story.ask(TRAINED), "the result is gone")
        place = story.ask(f"bpy.data.objects['{VASE} Gaussians'].matrix_world.translation[1]")
        expect(abs(float(str(place))) > 0.2, "the vase was moved back")
        blender.scroll(40)

    story.step("reopen", reopen)


def main() -> int:
    """Run all steps."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures" / "afternoon")
    options.add_argument("--side", type=int, default=320, help="of the photos, in pixels (320)")
    given = options.parse_args()
    python = {"ROIGS_ENGINE_PYTHON": os.fspath(given.engine_python)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        archive = built_extension(given.blender, folder)
        resources, blend = folder / "resources", folder / "afternoon.blend"
        resources.mkdir()
        screen, log = Screen(*SIZE), given.out / "blender.log"
        given.out.mkdir(parents=True, exist_ok=True)

        def window(*arguments: str) -> Blender:
            return Blender(
                given.blender, screen, resources, log=log, arguments=arguments, variables=python
            )

        try:
            with window() as blender:
                blender.ask(BEGIN)
                story = Afternoon(blender, folder, given.out)
                before_training(story, archive, given.side)
                blender.ask(f"bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r}) and None")
                training(story)
                artwork(story)
                second_training(story, given.side // 2)
            with window(str(blend)) as blender:
                story.blender = blender
                next_day(story)
        except WindowError as error:
            print(f"step {story.done} failed: {error}", file=sys.stderr)
            return 1
        finally:
            screen.close()
    log.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
