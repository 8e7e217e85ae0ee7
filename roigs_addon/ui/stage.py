"""Step 5, Result: the user's own objects in the captured scene."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..jobs import current
from ..jobs.spec import STAGING
from ..operators.stage import PLACES, CatchShadows, LightFromScene, RemoveStage
from ..operators.stand_here import StandHere
from ..scene import display, lookup, proxies, shadow_pass, stage, stage_world
from ..stage_properties import stage_props
from . import layout as show
from .layout import SidebarPanel
from .result import ResultPanel


class StagePanel(SidebarPanel):
    """Light, shadows and reflections, and what they lack."""

    bl_idname = "ROIGS_PT_stage"
    bl_parent_id = ResultPanel.bl_idname
    bl_label = "Your Own Objects"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians, or a stage to remove."""
        scene = scene_of(context)
        return bool(lookup.splats(scene) or stage.is_set(scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Show the buttons, and the settings of existing light and proxies."""
        layout, scene = layout_of(self), scene_of(context)
        group = stage_props(scene)
        layout.operator(StandHere.bl_idname, icon="TRACKER")
        show.job(layout, STAGING)
        column = layout.column(align=True)
        column.label(text=f"{LightFromScene.bl_label}:")
        row = column.row(align=True)
        for where, label, _ in PLACES:
            row.operator(LightFromScene.bl_idname, text=label).where = where
        if (world := stage_world.light(scene)) is not None:
            settings = show.setting_column(layout)
            for name in (stage_world.STRENGTH, stage_world.HIGHLIGHTS):
                if (socket := stage_world.value(world, name)) is not None:
                    settings.prop(socket, "default_value", text=name)
        elif group.world is not None:
            show.todo(layout, "You chose another world: it replaces the captured light")
        layout.operator(CatchShadows.bl_idname, icon="MESH_PLANE")
        if proxies.of_scene(scene):
            column = layout.column(align=True)
            column.prop(group, "catches")
            column.prop(group, "reflects")
            if names := proxies.lacking(scene):
                show.todo(layout, f"No mesh of {', '.join(names)}: Make Surface, then click again")
            if any(display.is_native(item) for item in lookup.splats(scene)):
                show.wrong(layout, "Blender's own splats receive no shadows: choose Exact Look")
        if stage.is_set(scene):
            if scene.render.engine != shadow_pass.CYCLES:
                show.wrong(layout, "Shadows on captured surfaces need Cycles")
            layout.operator(RemoveStage.bl_idname, icon="X")
        elif not current.busy():
            show.todo(layout, "Add a mesh, click Stand Here, then click a surface")


register, unregister = registration(StagePanel)
