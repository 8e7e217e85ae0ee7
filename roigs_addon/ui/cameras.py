"""Step 3, Cameras: how well the photos cover the active box, and which of them may be bad."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..facts import photo_names
from ..jobs.spec import CHECKING
from ..operators.photos import SelectCameras
from ..operators.suggest import CheckPhotos
from ..properties import object_props
from ..scene import checked, lookup, selections
from . import exclusions
from . import layout as show
from .layout import SidebarPanel

VISIBLE = 0.3  # stops; photos that differ by less look alike


class CamerasPanel(SidebarPanel):
    """The check of the photos."""

    bl_idname = "ROIGS_PT_cameras"
    bl_label = "3. Cameras"

    def draw(self, context: bpy.types.Context) -> None:
        """Show the button, and the check of the active box."""
        layout, scene, roi = layout_of(self), scene_of(context), lookup.active_roi(context)
        layout.operator(CheckPhotos.bl_idname, icon="VIEWZOOM")
        exclusions.counted(layout, scene)
        if roi is None:
            show.todo(layout, "Add a box first")
            return
        if not show.job(layout, CHECKING):
            _draw_check(layout, roi, scene)
        if object_props(roi).selection and selections.is_stale(roi, scene):
            old = f"{roi.name} was moved: its list of photos is old"
            too = "Its list of photos is old, too"
            show.wrong(layout, too if checked.is_stale(roi, scene) else old)
            again = layout.operator(SelectCameras.bl_idname, text="Select Again")
            again.active_only = True


def _draw_check(layout: bpy.types.UILayout, roi: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Show how well the photos cover a box, and the doubtful ones."""
    found = checked.of_box(roi)
    if found is None:
        show.todo(layout, f"{roi.name}: photos not checked yet")
        return
    if checked.is_stale(roi, scene):
        show.wrong(layout, f"{roi.name} was moved: click Check Photos")
        return
    show.done(layout, f"{roi.name}: {found.pixels:.0f} px across in photos")
    more = f", {found.later:.0%} with {found.suggested} more" if found.suggested else ""
    layout.progress(factor=found.known, text=f"{found.known:.0%} covered{more}")
    if found.exposure_spread >= VISIBLE:
        show.done(layout, f"Exposures differ by {found.exposure_spread:.1f} stops")
    if photo_names.count(scene) > found.of:
        show.wrong(layout, "Photos were added: click Check Photos")
    if sides := checked.sides_without_photos(roi, scene):
        show.wrong(layout, f"No photo from {' and '.join(sides)}")
    exclusions.faulty(layout, scene, checked.faults_of(roi))


register, unregister = registration(CamerasPanel)
