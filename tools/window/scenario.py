"""The start of all window scripts: the demo scene, in a Blender with the extension."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .driver import REPOSITORY, Blender, Screen, WindowError, with_extension

SCENE = REPOSITORY / "demo" / "scene"
TAB = "ROI-GS"


def addon(module: str) -> str:
    """Code for `Blender.ask` that gives a module of the add-on."""
    return f"__import__('sys').modules['bl_ext.user_default.roigs.roigs_addon.{module}']"


CURRENT = addon("jobs.current")
JOB, STATE, BUSY = f"{CURRENT}.job", f"{CURRENT}.state()", f"{CURRENT}.busy()"
"""Code for `Blender.ask`: the job, its state, and whether one is running."""

PREPARE = """
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.filepaths.use_auto_save_temporary_files = False
bpy.context.preferences.view.smooth_view = 0
for item in list(bpy.data.objects):
    bpy.data.objects.remove(item)
view()["area"].spaces.active.show_region_ui = True
bpy.context.scene.view_settings.view_transform = "Standard"
"""

ABOVE_TRAIN = {"roigs.scribble": 52, "roigs.select_cameras": 78, "roigs.suggest_photos": 104}
"""Button -> pixels from the field **Preset** up to the header of the button's closed sub-panel."""


def parser(text: str | None) -> argparse.ArgumentParser:
    """A parser with the options that all scenarios share."""
    made = argparse.ArgumentParser(description=text)
    made.add_argument("blender", type=Path, help="Blender's executable")
    made.add_argument("--engine-python", type=Path, required=True, help="a Python with torch")
    return made


@contextmanager
def window(given: argparse.Namespace, width: int, height: int) -> Iterator[Blender]:
    """Start the Blender of `parser`'s options with the extension, in a window of this size."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        resources = with_extension(given.blender, folder)
        screen = Screen(width, height)
        log, python = folder / "blender.log", os.fspath(given.engine_python)
        try:
            with Blender(
                given.blender,
                screen,
                resources,
                log=log,
                variables={"ROIGS_ENGINE_PYTHON": python},
            ) as blender:
                yield blender
        finally:
            screen.close()


@contextmanager
def pictured_failure(blender: Blender, out: Path) -> Iterator[None]:
    """If the block fails, write a picture of the window to `out`, and print the end of the log."""
    try:
        yield
    except Exception:
        blender.screen.picture(out / "failed.png")
        print(blender.log.read_text("utf-8", "replace")[-4000:], file=sys.stderr)
        raise


def prepare(blender: Blender) -> None:
    """Empty the file, and show the add-on's tab in the sidebar."""
    blender.ask(PREPARE)
    show_tab(blender)


def show_tab(blender: Blender) -> None:
    """Show the add-on's tab in the sidebar."""
    blender.ask("view()['area'].spaces.active.show_region_ui = True")
    blender.pause(0.5)
    blender.press("Escape")  # the splash screen
    blender.ask(f"part(view()['area'], 'UI').active_panel_category = '{TAB}'")
    blender.pause(0.5)


def import_demo(blender: Blender) -> None:
    """Import the demo scene, as from the file browser."""
    blender.ask(f"call('roigs.import_colmap', directory={str(SCENE)!r})")
    blender.ask("call('view3d.view_all')")


def load_boxes(blender: Blender) -> None:
    """Load the demo's boxes."""
    blender.ask(f"call('roigs.load_rois', filepath={str(SCENE / 'rois.json')!r})")


def open_panel(blender: Blender, command: str, x: float, above: tuple[str, float]) -> None:
    """Open the sub-panel that contains a button, by a click on the panel's header.

    Args:
        command: the button's command, see `Blender.find`.
        x: the button's place, as a share of the sidebar's width.
        above: command and place of the last button above the header.
    """
    column, row = blender.find(above[0], x=above[1])
    for below in range(24, 130, 12):
        blender.click((column, row + below))
        blender.pause(0.7)
        try:
            blender.find(command, x=x)
        except WindowError:
            column, row = blender.find(above[0], x=above[1])
        else:
            return
    raise WindowError("The panel did not open.")


def open_photos_panel(blender: Blender, command: str, x: float) -> None:
    """Open a sub-panel of step 3 by a click on its header, above the first field of step 4."""
    scale = blender.ask("bpy.context.preferences.view.ui_scale")
    column, row = blender.find("roigs.preset", x=0.7)
    blender.click((column, row - round(scale * ABOVE_TRAIN[command])))
    blender.pause(1.0)
    blender.find(command, x=x)


def open_result_panel(blender: Blender, command: str, x: float) -> None:
    """Open the sub-panel of step 5 that contains a button; its header is below the export."""
    open_panel(blender, command, x, ("roigs.export_gaussians", 0.8))
