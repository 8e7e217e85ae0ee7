"""A newcomer's afternoon in a real Blender window: fifteen steps by mouse and keys, with pictures.

    python -m tools.window.afternoon BLENDER --engine-python PYTHON [--out FOLDER] [--steps F]

Needs what `driver` needs. Begins with the factory settings and their default cube. Prints a line
per step with its seconds; the exit status is 1 when a step did not do what it should.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .driver import REPOSITORY, Blender, Screen, WindowError
from .scenario import BUSY, SCENE, STATE, TAB, parser

SIZE = (1400, 1000)
COLOURS = ("+dither", "-colors", "128")
BOX = "vase"

BEGIN = """
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
bpy.context.preferences.view.smooth_view = 0
bpy.context.preferences.filepaths.use_auto_save_temporary_files = False
"""
MINE = "[o for o in bpy.context.scene.objects if o.roigs.kind == {kind!r}]"


class Afternoon:
    """The steps, one after another, in one window and then in a second one."""

    def __init__(self, blender: Blender, folder: Path, out: Path) -> None:
        self.blender, self.folder, self.out = blender, folder, out
        self.number = 0

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time a step, and photograph the window after it."""
        self.number += 1
        start = time.monotonic()
        yield
        seconds = time.monotonic() - start
        self.blender.screen.do("mousemove", "3", "500")
        self.blender.pause(2.0)
        name = f"{self.number:02d}-{name}"
        self.blender.screen.picture(self.out / f"{name}.png", "", *COLOURS)
        print(f"{name:<24}{seconds:7.1f} s", flush=True)

    def over_view(self) -> None:
        """Move the mouse over the 3D view, which keys then go to."""
        self.blender.screen.do("mousemove", str(SIZE[0] // 3), str(SIZE[1] // 3))
        self.blender.pause(0.3)

    def keys(self, *keys: str) -> None:
        """Press keys over the 3D view, one after another."""
        self.over_view()
        for key in keys:
            self.blender.press(key)
            self.blender.pause(0.3)

    def button(self, command: str, x: float = 0.5) -> None:
        """Click a button of the sidebar."""
        self.blender.click(self.blender.find(command, x))

    def number_field(self, name: str, value: int) -> None:
        """Type a number into a field of the sidebar."""
        x, y = self.blender.find(name, 0.7)
        self.blender.screen.do("mousemove", str(x), str(y), "click", "--repeat", "2", "1")
        self.blender.pause(0.4)
        self.blender.press("ctrl+a")
        self.blender.type(str(value))
        self.blender.press("Return")
        self.blender.pause(0.4)

    def until_idle(self, seconds: float = 3600.0) -> None:
        """Wait until the engine has ended; an error fails."""
        self.blender.until(f"not {BUSY}", seconds)
        error = self.blender.ask(f"{STATE}.error")
        if error:
            raise WindowError(str(error))


def boxed(story: Afternoon) -> None:
    """Add a box and fit it to the vase with typed moves and scales, as one does by eye."""
    blender = story.blender
    story.button("roigs.add_roi")
    blender.until(f"len({MINE.format(kind='ROI')}) == 1")
    target = blender.ask(
        "[[float(x) for x in v] for v in __import__('sys').modules['__main__'].target()]"
    )
    box = f"{MINE.format(kind='ROI')}[0]"
    for axis, at, wanted in zip("xyz", blender.ask(f"list({box}.matrix_world.translation)"), target[0]):
        story.keys("g", axis)
        blender.type(f"{wanted - at:.4f}")
        blender.press("Return")
        blender.pause(0.3)
    for axis, now, wanted in zip("xyz", blender.ask(f"list({box}.matrix_world.to_scale())"), target[1]):
        story.keys("s", axis)
        blender.type(f"{wanted / now:.4f}")
        blender.press("Return")
        blender.pause(0.3)
