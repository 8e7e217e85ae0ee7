"""Step 3, Cameras: strokes on photos and masks made from them."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..facts import photo_names
from ..jobs.spec import MASKING
from ..operators.masks import MakeMasks, RemoveMasks, StepMask
from ..operators.scribble import ClearStrokes, Scribble
from ..properties import scene_props
from ..scene import lookup, masks, scribbles
from ..shared import text
from ..viewport import photo_overlay
from . import layout as show
from .cameras import CamerasPanel
from .layout import SidebarPanel


class MasksPanel(SidebarPanel):
    """From a few strokes on one photo to the object's masks on all photos of the box."""

    bl_idname = "ROIGS_PT_masks"
    bl_parent_id = CamerasPanel.bl_idname
    bl_label = "Object Mask"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return lookup.active_roi(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Show the photo, the strokes, the buttons for masks, and the job."""
        layout, scene, roi = layout_of(self), scene_of(context), lookup.active_roi(context)
        if roi is None:
            return
        photo, drawn = masks.photo_at_hand(context), scribbles.photos(roi)
        row = layout.row(align=True)
        row.operator(StepMask.bl_idname, text="", icon="TRIA_LEFT").step = -1
        name = photo_names.short_name(scene, photo.name) if photo else "No photo"
        row.label(text=name, icon="IMAGE_DATA")
        row.prop(scene_props(scene), "show_masks", text="", icon="HIDE_OFF")
        row.operator(StepMask.bl_idname, text="", icon="TRIA_RIGHT").step = 1
        row = layout.row(align=True)
        row.operator(Scribble.bl_idname, icon="GREASEPENCIL")
        row.operator(ClearStrokes.bl_idname, text="", icon="X")
        if drawn:
            show.done(layout, f"{roi.name}: strokes on {text.counted(len(drawn), 'photo')}")
        else:
            show.todo(layout, f"{roi.name}: draw on the object, with Ctrl around it")
        row = layout.row(align=True)
        row.operator(MakeMasks.bl_idname, icon="MOD_MASK").anew = False
        row.operator(MakeMasks.bl_idname, text="", icon="FILE_REFRESH").anew = True
        row.operator(RemoveMasks.bl_idname, text="", icon="TRASH")
        show.job(layout, MASKING)
        if problem := photo_overlay.problem():
            show.wrong(layout, problem)


register, unregister = registration(MasksPanel)
