"""Step 5, Result: tools to select and delete Gaussians."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration
from ..jobs.spec import CONFIDENCE, FLOATERS
from ..operators.clean_up import (
    ACTIONS,
    ChooseByBox,
    ChooseByLook,
    DeleteChosen,
    ForgetChosen,
    marked,
)
from ..operators.confidence import ChooseByDirections, FindConfidence, ShowHeatMap
from ..operators.erase_brush import EraseBrush
from ..operators.floaters import FindFloaters
from ..scene import heat_map, point_edits
from . import layout as show
from .layout import SidebarPanel
from .look import LookPanel
from .result import ResultPanel


class CleanUpPanel(SidebarPanel):
    """Tools that work on the selected Gaussian objects, or on all that are visible."""

    bl_idname = "ROIGS_PT_clean_up"
    bl_parent_id = ResultPanel.bl_idname
    bl_label = "Clean Up Gaussians"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians that can be edited."""
        return bool(point_edits.targets(context))

    def draw(self, context: bpy.types.Context) -> None:
        """Show the tools, then the number of selected Gaussians."""
        layout, items = layout_of(self), point_edits.targets(context)
        chosen = [item for item in items if item.select_get()]
        names = ", ".join(item.name for item in chosen) or "all visible Gaussians"
        show.say(layout, f"Works on {names}", "INFO")
        column = layout.column(align=True)
        for label, where in (("Outside boxes", "OUTSIDE"), ("Inside active box", "INSIDE")):
            for button in _pair(column, label, ChooseByBox.bl_idname):
                button.where = where
        _pair(column, "Faint or large", ChooseByLook.bl_idname)
        _pair(column, FindFloaters.bl_label, FindFloaters.bl_idname)
        _pair(column, "By brush", EraseBrush.bl_idname)
        if heat_map.asked(items):
            _pair(column, "Few directions", ChooseByDirections.bl_idname)
        show.job(layout, FLOATERS)
        _confidence(layout, items)
        if count := point_edits.count_chosen(marked(context)):
            row = layout.row(align=True)
            label = f"Delete {count:,} Selected"
            row.operator(DeleteChosen.bl_idname, text=label, icon="TRASH")
            row.operator(ForgetChosen.bl_idname, text="", icon="X")
        if not LookPanel.poll(context):
            show.say(layout, "For brightness and tint, click one and open Look", "BLANK1")


def _confidence(layout: bpy.types.UILayout, items: list[bpy.types.Object]) -> None:
    """Show the buttons for the confidence of the Gaussians, and the meaning of its colours."""
    row, most = layout.row(align=True), heat_map.most()
    row.operator(FindConfidence.bl_idname)
    if heat_map.asked(items):
        row.operator(ShowHeatMap.bl_idname, icon="HIDE_OFF", depress=most is not None)
    show.job(layout, CONFIDENCE)
    if most is not None:
        show.say(layout, f"Blue: few directions. Yellow: {most:.0f} or more", "INFO")


def _pair(
    column: bpy.types.UILayout, label: str, operator: str
) -> list[bpy.types.OperatorProperties]:
    """Show a tool as two buttons, one that selects and one that deletes; return them."""
    row = column.split(factor=0.46, align=True)
    row.label(text=label)
    buttons = []
    for action, title, _ in ACTIONS:
        button = row.operator(operator, text=title)
        button.action = action
        buttons.append(button)
    return buttons


register, unregister = registration(CleanUpPanel)
