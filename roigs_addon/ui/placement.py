"""Step 1, Scene: place the scene."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..operators.placement import KeepPlacement, SetFloor, SetOrigin, SetScale, root_problem
from ..properties import scene_props
from ..scene import placement
from ..shared import scene_transform as stored
from . import layout as show
from .layout import SidebarPanel
from .scene import ScenePanel


class PlacementPanel(SidebarPanel):
    """Floor, scale and origin."""

    bl_idname = "ROIGS_PT_placement"
    bl_parent_id = ScenePanel.bl_idname
    bl_label = "Placement"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model."""
        return not root_problem(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Show the tools, and whether the placement is saved for other files."""
        layout, scene = layout_of(self), scene_of(context)
        layout.operator(SetFloor.bl_idname, icon="GRID")
        row = layout.row(align=True)
        props = scene_props(scene)
        row.operator(SetScale.bl_idname, icon="DRIVER_DISTANCE").length = props.known_length
        row.prop(props, "known_length", text="")
        layout.operator(SetOrigin.bl_idname, icon="OBJECT_ORIGIN")
        if placement.is_kept(scene):
            show.done(layout, f"Saved in {stored.FILE}")
        else:
            layout.operator(KeepPlacement.bl_idname, icon="FILE_TICK")


register, unregister = registration(PlacementPanel)
