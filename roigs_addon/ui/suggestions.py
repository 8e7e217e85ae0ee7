"""Step 3, Cameras: places for the next photos."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..jobs.spec import SUGGESTING
from ..operators.suggest import (
    LookThroughSuggestion,
    OpenSuggestions,
    RemoveSuggestions,
    SuggestPhotos,
)
from ..properties import scene_props
from ..scene import lookup, suggestions
from . import layout as show
from .cameras import CamerasPanel
from .layout import SidebarPanel

NUMBER = 0.1
"""Share of a row's width for the number of a photo."""


class SuggestionsPanel(SidebarPanel):
    """Places for the next photos of the boxes."""

    bl_idname = "ROIGS_PT_suggestions"
    bl_parent_id = CamerasPanel.bl_idname
    bl_label = "Next Photos"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return lookup.active_roi(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Show the buttons, the job, and the suggestions of the active box."""
        layout, scene, roi = layout_of(self), scene_of(context), lookup.active_roi(context)
        if roi is None:
            return
        show.setting_column(layout).prop(scene_props(scene), "suggested")
        row = layout.row(align=True)
        row.operator(SuggestPhotos.bl_idname, icon="OUTLINER_OB_CAMERA")
        row.operator(OpenSuggestions.bl_idname, text="", icon="URL")
        row.operator(RemoveSuggestions.bl_idname, text="", icon="TRASH")
        if show.job(layout, SUGGESTING):
            return
        shots = suggestions.of_box(scene, roi)
        column = layout.column(align=True)
        for item in shots:
            known = suggestions.known_of(item)
            if known is None:
                continue
            row = column.row(align=True)
            split = row.split(factor=NUMBER, align=True)
            split.label(text=f"{known.number}")
            gain = f"+{known.gain:.2f} dB, {known.known:.0%} covered"
            split.progress(factor=min(max(known.known, 0.0), 1.0), text=gain)
            look = LookThroughSuggestion.bl_idname
            row.operator(look, text="", icon="HIDE_OFF").camera = item.name
        active = next((item for item in shots if item == scene.camera), None)
        known = suggestions.known_of(active) if active is not None else None
        if known is not None:
            show.say(layout, known.words, "INFO")


register, unregister = registration(SuggestionsPanel)
