"""Step 5, Result: exposure and tint of the selected Gaussians."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..facts import photo_names, run_facts
from ..operators.look import ExposureOfPhoto
from ..properties import object_props
from ..scene import look, lookup
from .layout import SidebarPanel
from .result import ResultPanel


class LookPanel(SidebarPanel):
    """The look of the active object, if it is drawn as Gaussians."""

    bl_idname = "ROIGS_PT_look"
    bl_parent_id = ResultPanel.bl_idname
    bl_label = "Look"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must be drawn as Gaussians."""
        return look.is_drawn(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Show its exposure and tint, which can be keyframed."""
        layout, item = layout_of(self), context.active_object
        assert item is not None
        layout.label(text=item.name)
        column = layout.column(align=True)
        column.use_property_split = True
        column.prop(object_props(item), "exposure")
        column.prop(object_props(item), "tint")
        _draw_exposures(layout, scene_of(context))


def _draw_exposures(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """The range of the photos' exposures, and the one that the scene looks through."""
    stops = run_facts.result(scene).exposures
    if not stops:
        return
    low, high = min(stops.values()), max(stops.values())
    layout.label(text=f"Photos: {low:+.1f} to {high:+.1f} stops")
    photo = lookup.photo_record(scene.camera) if scene.camera is not None else None
    if photo is not None and photo.name in stops:
        name = photo_names.short_name(scene, photo.name)
        text = f"As in {name} ({stops[photo.name]:+.1f} stops)"
        layout.operator(ExposureOfPhoto.bl_idname, text=text).photo = photo.name


register, unregister = registration(LookPanel)
