"""Step 5, Result: boxed objects under other light, and as assets."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..jobs import current
from ..jobs.spec import RELIGHTING
from ..operators.relight import Relight, StopRelight, TakeObject
from ..scene import box_surfaces, relight, taken
from . import layout as show
from .layout import SidebarPanel
from .surface import SurfacePanel


class RelightPanel(SidebarPanel):
    """A slider and buttons for each mesh."""

    bl_idname = "ROIGS_PT_relight"
    bl_parent_id = SurfacePanel.bl_idname
    bl_label = "Relight and Take"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a mesh."""
        return bool(box_surfaces.surfaces(scene_of(context)))

    def draw(self, context: bpy.types.Context) -> None:
        """Show each mesh with its slider and buttons."""
        layout, scene = layout_of(self), scene_of(context)
        for item in box_surfaces.surfaces(scene):
            column = layout.column(align=True)
            column.label(text=item.name)
            if relight.is_on(item):
                row = column.row(align=True)
                row.prop(item, f'["{relight.SLIDER}"]', slider=True)
                row.operator(StopRelight.bl_idname, text="", icon="X").name = item.name_full
            row = column.row(align=True)
            row.operator(Relight.bl_idname, icon="LIGHT").name = item.name_full
            row.operator(TakeObject.bl_idname, icon="ASSET_MANAGER").name = item.name_full
            if relight.is_lacking(item) and not current.busy():
                show.wrong(layout, f"'{item.name}' was made again: click Relight again")
        for name in taken.names():
            show.say(layout, f"Asset: {name}", "ASSET_MANAGER")
        show.job(layout, RELIGHTING)


register, unregister = registration(RelightPanel)
