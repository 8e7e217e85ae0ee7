"""Step 5, Result: exposure and tint of the selected Gaussians."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration
from ..properties import object_props
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
        item = context.active_object
        if item is None or object_props(item).kind != "SPLATS":
            return False
        return bool(object_props(item).shown_as != "POINTS")

    def draw(self, context: bpy.types.Context) -> None:
        """Show its exposure and tint, which can be keyframed."""
        layout, item = layout_of(self), context.active_object
        assert item is not None
        layout.label(text=item.name)
        column = layout.column(align=True)
        column.use_property_split = True
        column.prop(object_props(item), "exposure")
        column.prop(object_props(item), "tint")


register, unregister = registration(LookPanel)
