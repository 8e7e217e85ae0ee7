"""Step «Regions»: boxes around what is to be sharp."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import bpy
import mathutils
from bpy.props import FloatVectorProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from .. import lookup, regions
from ..errors import AddonError
from .base import FRESH, OperatorResult, available, failed
from .select import mark_chosen


class AddRoi(bpy.types.Operator):
    """Add a box around the selected vertices or objects, or at the 3D cursor"""

    bl_idname = "roigs.add_roi"
    bl_label = "Add ROI"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """A cube empty; move, turn and scale it with the usual tools."""
        scene = context.scene
        place = self._around_selection(context)
        if place is None:
            half = regions.default_size(scene)
            place = scene.cursor.location.copy(), mathutils.Vector((half, half, half))
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        _select(context, regions.new_roi(scene, *place))
        return {"FINISHED"}

    def _around_selection(self, context: bpy.types.Context):
        active = context.active_object
        if context.mode == "EDIT_MESH" and active is not None:
            active.update_from_editmode()
            return regions.around_selected_vertices(active)
        ours = {"ROI", "CAMERA", "ROOT", "POINTS"}
        chosen = [
            o for o in context.selected_objects if o.type == "MESH" and o.roigs.kind not in ours
        ]
        return regions.around_objects(chosen) if chosen else None


class AddBox(bpy.types.Operator):
    """Add a box by two corners in the COLMAP frame, for scripts"""

    bl_idname = "roigs.add_box"
    bl_label = "Add ROI by Corners"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Name", default="ROI", options=FRESH)
    low: FloatVectorProperty(name="From", default=(-1, -1, -1), precision=4, options=FRESH)
    high: FloatVectorProperty(name="To", default=(1, 1, 1), precision=4, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Where the root is moved, the box goes with it."""
        try:
            box = regions.from_corners(self.low, self.high)
            regions.add_boxes(context.scene, {self.name: box})
        except ValueError as error:
            return failed(self, AddonError(f"ROI «{self.name}» is no box: {error}."))
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


class LoadRois(bpy.types.Operator, ImportHelper):
    """Add the boxes of a rois.json"""

    bl_idname = "roigs.load_rois"
    bl_label = "Load ROIs"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".json"
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    filter_glob: StringProperty(default="*.json", options={"HIDDEN", *FRESH})

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Boxes of the COLMAP frame, below the root."""
        try:
            boxes = regions.load(Path(bpy.path.abspath(self.filepath)))
            regions.add_boxes(context.scene, boxes)
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


class RemoveRoi(bpy.types.Operator):
    """Remove the active box; what was trained stays"""

    bl_idname = "roigs.remove_roi"
    bl_label = "Remove ROI"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be one."""
        return available(cls, "" if lookup.active_roi(context) else "Add a ROI first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Delete the empty."""
        boxes, roi = lookup.rois(context.scene), lookup.active_roi(context)
        at = boxes.index(roi)
        bpy.data.objects.remove(roi)
        rest = boxes[:at] + boxes[at + 1 :]
        context.scene.roigs.active_roi = rest[min(at, len(rest) - 1)] if rest else None
        mark_chosen(context.scene)
        return {"FINISHED"}


class SelectRoi(bpy.types.Operator):
    """Make this box the active object"""

    bl_idname = "roigs.select_roi"
    bl_label = "Select ROI"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the box", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Select it, and nothing else."""
        roi = next((r for r in lookup.rois(context.scene) if r.name == self.name), None)
        if roi is None:
            self.report({"ERROR"}, f"There is no ROI «{self.name}».")
            return {"CANCELLED"}
        _select(context, roi)
        return {"FINISHED"}


def _select(context: bpy.types.Context, roi: bpy.types.Object) -> None:
    """In the panel and, unless its collection is excluded there, in the view layer."""
    context.scene.roigs.active_roi = roi
    for item in context.selected_objects:
        item.select_set(False)
    with suppress(RuntimeError):
        roi.select_set(True)
        context.view_layer.objects.active = roi


CLASSES = (AddRoi, AddBox, LoadRois, RemoveRoi, SelectRoi)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
