"""Puts things into a capture by clicks in a real Blender window; makes pictures and checks.

    python -m tools.window.stand BLENDER --engine-python PYTHON --run FOLDER [--out FOLDER]

Needs what `driver` needs, and a finished run of the demo scene with meshes of its boxes, of which
it takes a copy. The things are those of `benchmarks.insertion`, each on its place by a click; a
lamp shines on the relit vase. What is rendered is named `f12-`, for a look beside the truth.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .clean_up import IN_WINDOW, check
from .driver import REPOSITORY, Blender, WindowError
from .pictures import LOOK
from .scenario import (
    BUSY,
    STATE,
    import_demo,
    load_boxes,
    parser,
    pictured_failure,
    prepare,
    window,
)

SIZE = (1280, 980)
PHOTO, OTHER = "wide/wide_045.jpg", "wide/wide_005.jpg"
"""Photos whose cameras look at the table. From the first, the first three things are placed. From
the other side, the monkey is placed, because the vase hides its place, and renders are made."""
SURFACE, STAGE = ("roigs.export_gaussians", 0.8, 50), ("roigs.export_gaussians", 0.8, 72)
RELIGHT = ("roigs.make_surface", 0.5, 47)
"""Header of a closed panel: button above it, that button's share of the width, pixels below it."""
LIMIT = 0.015
"""Largest error of a thing's place, also above or below the table; metres, 3 pixels."""
RENDERING = "bpy.app.is_job_running('RENDER')"

INSIDE = f"""
import sys
sys.path.insert(0, {str(REPOSITORY)!r})
long = "bl_ext.user_default.roigs."
sys.modules.update({{k.removeprefix(long): m for k, m in sys.modules.items() if long in k}})
from bpy_extras import view3d_utils
from mathutils import Vector
from benchmarks.insertion import things
from tests.addon import stage_cases

def scene():
    return bpy.context.scene

def state():
    return stage_cases.state(bpy, scene())

def corners(name):
    thing = scene().objects[name]
    return [thing.matrix_world @ vertex.co for vertex in thing.data.vertices]

def middle(name):
    return [(min(k) + max(k)) / 2 for k in zip(*corners(name))][:2]

def on_screen(place):
    found = view()
    data = found["area"].spaces.active.region_3d
    at = view3d_utils.location_3d_to_region_2d(found["region"], data, Vector(place))
    return found["region"].x + at.x, found["window"].height - 1 - found["region"].y - at.y

def select(name):
    for item in scene().objects:
        item.select_set(item.name == name)
    bpy.context.view_layer.objects.active = scene().objects[name]
"""
"""Code for the driver: imports this repository's modules, with the add-on by its short name."""

MAKE = """
made = things.put_things()
bpy.context.view_layer.update()
goals = {name: (*middle(name), things.TABLE) for name in made}
for number, thing in enumerate(made.values()):
    thing.location = 3 + number, 0, 0
"""
"""Code that makes the things, far from their places."""

SINCE = f"""
before["images"] = sorted({{*before["images"], {Path(OTHER).name!r}}})
before["objects"] = sorted({{*before["objects"], "lamp"}})
before["materials"] = sorted({{*before["materials"], "vase Mesh Relit"}})
before["lamps"] = {{"lamp": True}}
"""
"""Code that adds to `before` what has been added since and stays: the photo in the view, the lamp
as Blender makes it, and the relit vase."""

OWN = """
stage_cases.own_things(bpy, scene())
scene().view_layers["Extra"].use = False
scene().render.engine, scene().cycles.use_denoising = "CYCLES", True
scene().render.resolution_percentage = 100
"""
"""Code that makes a user's own settings: a world, a view layer, a node in the compositor."""


class Story:
    """The steps in one window."""

    def __init__(self, blender: Blender, out: Path) -> None:
        """Args: `out`: folder for the pictures."""
        self.blender, self.out = blender, out

    def ask(self, code: str) -> Any:
        """Evaluate an expression inside Blender."""
        return self.blender.ask(code)

    def picture(self, name: str) -> None:
        """Take a picture of the window."""
        self.blender.screen.do("mousemove", "3", "450")
        self.blender.pause(3.0)
        self.blender.screen.picture(self.out / f"{name}.png")

    def button(self, command: str, x: float) -> None:
        """Click a button of the sidebar."""
        self.blender.click(self.blender.find(command, x=x))

    def open(self, header: tuple[str, float, int]) -> None:
        """Open a panel by a click on its header."""
        command, x, below = header
        column, row = self.blender.find(command, x=x)
        self.blender.click((column, row + below))
        self.blender.pause(1.0)

    def until_done(self, picture: str = "") -> float:
        """Wait for the engine, with a picture of its progress; returns the seconds."""
        began = time.monotonic()
        self.blender.until(BUSY, 60)
        if picture:
            self.blender.scroll(100)
            self.picture(picture)
        self.blender.until(f"not {BUSY}", 1800)
        if error := self.ask(f"{STATE}.error"):
            raise WindowError(str(error))
        return time.monotonic() - began

    def over_view(self, *keys: str) -> None:
        """Press keys over the 3D view."""
        self.blender.screen.do("mousemove", str(SIZE[0] // 3), str(SIZE[1] // 3))
        self.blender.pause(0.5)
        for key in keys:
            self.blender.press(key)
            self.blender.pause(1.5)

    def until_state(self, name: str, text: str) -> None:
        """Wait until all settings are as in the stored state `name` inside Blender."""
        try:
            self.blender.until(f"state() == {name}", 20)
        except WindowError:
            changed = f"{{k: (v, state()[k]) for k, v in {name}.items() if v != state()[k]}}"
            raise WindowError(f"{text}: {self.ask(changed)}") from None
        check(text, True)


def stand(story: Story) -> None:
    """Place all things, one click each; undo and redo the first."""
    story.ask(MAKE)
    story.ask("bpy.ops.ed.undo_push(message='things')")
    story.ask("before = state()")
    for number, name in enumerate(story.ask("list(goals)")):
        if name == "monkey":
            look_through(story, OTHER)
        put(story, name, "1-progress" if not number else "")
        if not number:
            story.ask("staged = state()")
            story.over_view("ctrl+z")
            story.until_state("before", "Ctrl-Z takes all back")
            story.over_view("ctrl+shift+z")
            story.until_state("staged", "Ctrl-Shift-Z brings it again")
    story.picture("2-standing")


def look_through(story: Story, photo: str) -> None:
    """Look at the result through a photo's camera."""
    blender = story.blender
    blender.ask(f"call('roigs.look_through', photo={photo!r})")
    blender.until(f"not {BUSY}", 120)
    blender.ask("scene().roigs.compare_photo = False")
    blender.ask("scene().camera.data.show_background_images = False")
    blender.pause(5.0)


def put(story: Story, name: str, picture: str) -> None:
    """Select a thing, click the button, click its place."""
    blender = story.blender
    story.ask(f"select({name!r})")
    story.button("roigs.stand_here", 0.5)
    blender.pause(1.0)
    x, y = (round(side) for side in story.ask(f"on_screen(goals[{name!r}])"))
    blender.screen.do("mousemove", str(x - 3), str(y))
    blender.pause(0.3)
    blender.click((x, y))
    seconds = story.until_done(picture)
    goal, found = story.ask(f"goals[{name!r}]"), story.ask(f"middle({name!r})")
    low = story.ask(f"min(corner.z for corner in corners({name!r}))")
    away = sum((a - b) ** 2 for a, b in zip(found, goal, strict=False)) ** 0.5
    said = f"{name} stands {1000 * away:.1f} mm from the click, {1000 * (low - goal[2]):+.1f} mm"
    check(f"{said} above the table, after {seconds:.0f} s", max(away, abs(low - goal[2])) < LIMIT)


def switches(story: Story) -> None:
    """Measure light at the cursor, redo shadows, switch reflections off and on."""
    story.ask("scene().cursor.location = (0, 0, 0.9)")
    story.button("where='CURSOR'", 0.5)
    check(f"Light From Scene: {story.until_done():.0f} s", True)
    story.button("roigs.catch_shadows", 0.5)
    story.blender.pause(3.0)
    for on in (False, True):
        story.button("stage.reflects", 0.5)
        story.blender.until(f"scene().roigs.stage.reflects == {on}", 20)
    check("Reflections and Bounce goes off and on", True)
    story.picture("3-panel")


def relight(story: Story) -> None:
    """Add a lamp beside the vase, and relight the vase."""
    story.ask("things.put_lamp()")
    story.open(SURFACE)
    story.open(RELIGHT)
    story.button('roigs.relight(name="vase Mesh"', 0.3)
    check(f"Relight: {story.until_done():.0f} s", True)
    story.picture("5-relight")


def f12(story: Story, name: str) -> None:
    """Render with F12, with pictures of the window, and save the render."""
    blender, began = story.blender, time.monotonic()
    story.over_view("F12")
    blender.until(RENDERING, 60)
    blender.until(f"not {RENDERING}", 3600)
    blender.pause(3.0)
    blender.screen.picture(story.out / f"{name}-window.png")
    path = story.out / f"f12-{name}.png"
    story.ask(f"bpy.data.images['Render Result'].save_render({str(path)!r})")
    check(f"F12: {time.monotonic() - began:.0f} s, {path.name}", path.is_file())
    blender.screen.do("mousemove", str(SIZE[0] // 3), str(SIZE[1] // 2))
    blender.pause(0.5)
    blender.press("Escape")
    blender.pause(2.0)


def remove(story: Story) -> None:
    """Remove the stage by a click, then undo with Ctrl-Z."""
    # A render makes the lamp shine on captured surfaces. That creates no undo step; the next does.
    story.ask("staged = {**state(), 'lamps': {'lamp': True}}")
    story.blender.scroll(100)  # below the long panel of surfaces
    story.button("roigs.remove_stage", 0.5)
    story.ask(SINCE)
    story.until_state("before", "Remove brings all back")
    story.picture("7-removed")
    story.over_view("ctrl+z")
    story.until_state("staged", "Ctrl-Z brings the light again")


def main() -> int:
    """Run the story, with pictures."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, help="a finished run of the demo")
    options.add_argument("--out", type=Path, default=Path("build/window"))
    options.add_argument("--size", type=int, default=75, help="of renders, percent of the photos'")
    options.add_argument("--samples", type=int, default=32, help="of a pixel, before the denoiser")
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary, window(given, *SIZE) as blender:
        story = Story(blender, given.out)
        with pictured_failure(blender, given.out):
            begin(story, shutil.copytree(given.run, Path(temporary, "run"), symlinks=True))
            stand(story)
            switches(story)
            story.ask(f"scene().cycles.samples = {given.samples}")
            story.ask(f"scene().render.resolution_percentage = {given.size}")
            f12(story, "4-things")
            relight(story)
            f12(story, "6-lamp")
            remove(story)
    return 0


def begin(story: Story, run: Path) -> None:
    """Open the demo's result, look through a photo's camera, and make a user's own settings."""
    blender = story.blender
    prepare(blender)
    blender.ask(LOOK + IN_WINDOW)
    blender.ask("bpy.context.preferences.view.render_display_type = 'SCREEN'")
    import_demo(blender)
    load_boxes(blender)
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    blender.ask("call('roigs.load_results')", 120)
    blender.ask(INSIDE)
    blender.ask(OWN)
    look_through(story, PHOTO)
    story.open(STAGE)


if __name__ == "__main__":
    sys.exit(main())
