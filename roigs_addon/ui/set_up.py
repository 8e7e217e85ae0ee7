"""Above all steps: a link to the preferences, until the engine is set up."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration
from ..facts import engine_ability
from . import layout as show
from .layout import SidebarPanel


class SetUpPanel(SidebarPanel):
    """The first step after the installation of the add-on; gone when the engine is set up."""

    bl_idname = "ROIGS_PT_set_up"
    bl_label = "Start Here"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The engine must have a problem."""
        return bool(engine_ability.problem())

    def draw(self, context: bpy.types.Context) -> None:
        """Show the problem and the button."""
        show.engine_problem(layout_of(self), engine_ability.problem())


register, unregister = registration(SetUpPanel)
