"""Step 2, Boxes."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..facts import point_counts
from ..operators.box_tools import FitToPoints, SnapToFloor
from ..operators.boxes import AddRoi, LoadRois, RemoveRoi, SelectRoi
from ..properties import object_props
from ..scene import lookup
from ..shared import text
from . import layout as show
from .layout import SidebarPanel


class BoxesPanel(SidebarPanel):
    """The boxes, with what is in them."""

    bl_idname = "ROIGS_PT_boxes"
    bl_label = "2. Boxes"

    def draw(self, context: bpy.types.Context) -> None:
        """Add, remove, load; one entry for each box."""
        layout, scene = layout_of(self), scene_of(context)
        row = layout.row(align=True)
        row.operator(AddRoi.bl_idname, icon="ADD")
        row.operator(RemoveRoi.bl_idname, text="", icon="REMOVE")
        row.operator(LoadRois.bl_idname, text="", icon="FILE_FOLDER")
        boxes = lookup.rois(scene)
        if not boxes:
            show.todo(layout, "Add a box around each object to sharpen")
            return
        active = lookup.active_roi(context)
        for roi in boxes:
            column = layout.box().column(align=True)
            row = column.row(align=True)
            button = row.operator(
                SelectRoi.bl_idname,
                text="",
                icon="RADIOBUT_ON" if roi == active else "RADIOBUT_OFF",
                emboss=False,
            )
            button.name = roi.name
            row.prop(roi, "name", text="")
            row.prop(roi, "hide_viewport", text="", emboss=False)
            _describe(column, roi, scene)
        row = layout.row(align=True)
        row.operator(FitToPoints.bl_idname)
        row.operator(SnapToFloor.bl_idname)


def _describe(layout: bpy.types.UILayout, roi: bpy.types.Object, scene: bpy.types.Scene) -> None:
    found = point_counts.count_soon(roi, scene)
    if found is None:
        show.wrong(layout, "Slanted or flat: check its rotation and size")
        return
    points, photos = found
    if not points:
        if lookup.points(scene) is not None:  # else step 1 reports the problem
            show.wrong(layout, "Empty: no sparse points inside. Move or enlarge it")
        return
    seen = "" if photos is None else f", seen in {text.counted(photos, 'photo')}"
    show.done(layout, f"{text.counted(points, 'point')}{seen}")


class PlacePanel(SidebarPanel):
    """The active box in numbers."""

    bl_idname = "ROIGS_PT_place"
    bl_parent_id = BoxesPanel.bl_idname
    bl_label = "Place and Size"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return lookup.active_roi(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Show its centre, half its sides, and its rotation."""
        layout, roi = layout_of(self), lookup.active_roi(context)
        if roi is None:
            return
        layout.label(text=roi.name)
        layout.column().prop(roi, "location", text="Centre")
        layout.column().prop(object_props(roi), "half_sides")
        turned = "rotation_quaternion" if roi.rotation_mode == "QUATERNION" else "rotation_euler"
        layout.column().prop(roi, turned, text="Rotation")


register, unregister = registration(BoxesPanel, PlacePanel)
