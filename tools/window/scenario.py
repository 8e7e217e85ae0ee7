"""How all window scripts begin: the demo scene, in a Blender that has the extension."""

from __future__ import annotations

import argparse
from pathlib import Path

from .driver import REPOSITORY, Blender

SCENE = REPOSITORY / "demo" / "scene"
TAB = "ROI-GS"
CURRENT = "__import__('sys').modules['bl_ext.user_default.roigs.roigs_addon.jobs.current']"
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


def parser(text: str | None) -> argparse.ArgumentParser:
    """A parser with the options that all of them have."""
    made = argparse.ArgumentParser(description=text)
    made.add_argument("blender", type=Path, help="Blender's executable")
    made.add_argument("--engine-python", type=Path, required=True, help="a Python with torch")
    return made


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
    """Import the demo scene, as the file browser would."""
    blender.ask(f"call('roigs.import_colmap', directory={str(SCENE)!r})")
    blender.ask("call('view3d.view_all')")


def load_boxes(blender: Blender) -> None:
    """Load the demo's boxes."""
    blender.ask(f"call('roigs.load_rois', filepath={str(SCENE / 'rois.json')!r})")
