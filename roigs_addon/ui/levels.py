"""Step 5, Result: levels of detail."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..jobs.spec import LEVELS
from ..operators.levels import MakeLevels
from ..properties import object_props, scene_props
from ..scene import display, ladders, lookup
from ..viewport import draw
from . import layout as show
from .layout import SidebarPanel
from .result import ResultPanel


class LevelsPanel(SidebarPanel):
    """Whether far things are drawn with fewer Gaussians, and how many that saves."""

    bl_idname = "ROIGS_PT_levels"
    bl_parent_id = ResultPanel.bl_idname
    bl_label = "Levels of Detail"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians of a training."""
        items = lookup.splats(scene_of(context))
        return any(object_props(item).level in ladders.ABOVE for item in items)

    def draw_header(self, context: bpy.types.Context) -> None:
        """Show the switch for levels."""
        layout_of(self).prop(scene_props(scene_of(context)), "use_levels", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Show the quality, the number of drawn Gaussians, and the button that makes levels."""
        layout, scene = layout_of(self), scene_of(context)
        problem, some = ladders.problem(scene), ladders.there_are_some(scene)
        if some:
            column = show.setting_column(layout)
            column.active = scene_props(scene).use_levels
            column.prop(scene_props(scene), "level_quality", slider=True)
        if counts := draw.counts(context.area):
            show.say(layout, "Drawn now: {:,} of {:,} Gaussians".format(*counts), "INFO")
        if problem:
            show.wrong(layout, problem)
        elif lookup.splats(scene) and not display.in_layer(scene):
            show.say(layout, "For Exact Look: Blender draws all of its splats", "INFO")
        elif not some:
            show.todo(layout, "Make levels to draw far objects faster")
        layout.operator(MakeLevels.bl_idname, icon="MOD_DECIM")
        show.job(layout, LEVELS)


register, unregister = registration(LevelsPanel)
