"""Step 2, Boxes: add boxes around the objects to sharpen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import mathutils
from bpy.props import BoolProperty, FloatVectorProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..blender import absolute, registration, scene_of, select_only
from ..errors import AddonError
from ..properties import object_props, scene_props
from ..scene import lookup, rois, selections, start_cube
from . import folders
from .base import FRESH, NO_BOX, available, box_problem, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult

OURS = {"ROI", "CAMERA", "ROOT", "POINTS"}
"""Kinds of objects that no box is added around."""


class AddRoi(bpy.types.Operator):
    """Add a box (ROI) around the selection, otherwise at the 3D cursor, otherwise around the main \
object of the photos"""

    bl_idname = "roigs.add_roi"
    bl_label = "Add Box"
    bl_options = {"REGISTER", "UNDO"}

    for_script: BoolProperty(
        description="The sides are in `scale`, where a script may set others",
        default=True,
        options={"HIDDEN", *FRESH},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """For the button, a menu or a key."""
        self.for_script = False
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Add a cube empty; it is moved, rotated and scaled with the usual tools.

        A cursor at the origin is one that nobody has moved.
        """
        scene = scene_of(context)
        place = self._around_selection(context)
        if place is None and not scene.cursor.location.length:
            place = rois.where_photos_look(scene)
        if place is None:
            half = rois.default_size(scene)
            place = scene.cursor.location.copy(), mathutils.Vector((half, half, half))
        _select(context, rois.new_roi(scene, *place, for_script=self.for_script))
        return {"FINISHED"}

    def _around_selection(self, context: bpy.types.Context) -> rois.Place | None:
        active = context.active_object
        if context.mode == "EDIT_MESH" and active is not None:
            active.update_from_editmode()
            return rois.around_selected_vertices(active)
        meshes = (o for o in context.selected_objects if o.type == "MESH")
        scene = scene_of(context)
        ignored = start_cube.untouched(scene) if lookup.points(scene) else None
        chosen = [o for o in meshes if object_props(o).kind not in OURS and o != ignored]
        return rois.around_objects(chosen) if chosen else None


class AddBox(bpy.types.Operator):
    """Add a box by two corners in the COLMAP frame, for scripts"""

    bl_idname = "roigs.add_box"
    bl_label = "Add Box by Corners"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Name", default="Box", options=FRESH)
    low: FloatVectorProperty(name="From", default=(-1, -1, -1), precision=4, options=FRESH)
    high: FloatVectorProperty(name="To", default=(1, 1, 1), precision=4, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Add it below the root, so that it moves with the root."""
        try:
            box = rois.between(self.name, self.low, self.high)
            rois.add_boxes(scene_of(context), {self.name: box})
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


class LoadRois(bpy.types.Operator, ImportHelper):  # type: ignore[misc] # the stub's mixin
    """Add the boxes of a rois.json file"""

    bl_idname = "roigs.load_rois"
    bl_label = "Load Boxes"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".json"
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    filter_glob: StringProperty(default="*.json", options={"HIDDEN", *FRESH})

    def invoke(  # type: ignore[override] # the stub of the mixin returns nothing
        self, context: bpy.types.Context, event: bpy.types.Event
    ) -> OperatorResult:
        """Ask for the file."""
        assert context.window_manager is not None
        self.filepath = folders.for_boxes(scene_props(scene_of(context)).colmap)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Add its boxes, which are in the COLMAP frame, below the root."""
        scene = scene_of(context)
        try:
            path = absolute(self.filepath)
            added = rois.add_boxes(scene, rois.read(path))
        except AddonError as error:
            return failed(self, error)
        folders.loaded_boxes(path, scene_props(scene).colmap)
        if added:
            _select(context, added[0])
        return {"FINISHED"}


class RemoveRoi(bpy.types.Operator):
    """Remove the active box; its trained Gaussians stay"""

    bl_idname = "roigs.remove_roi"
    bl_label = "Remove Box"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Delete the empty."""
        scene = scene_of(context)
        boxes, roi = lookup.rois(scene), lookup.active_roi(context)
        if roi is None:
            return failed(self, f"{NO_BOX}.")
        at = boxes.index(roi)
        bpy.data.objects.remove(roi)
        rest = boxes[:at] + boxes[at + 1 :]
        scene_props(scene).active_roi = rest[min(at, len(rest) - 1)] if rest else None
        selections.mark_chosen(scene)
        return {"FINISHED"}


class SelectRoi(bpy.types.Operator):
    """Make this box the active one, and select it"""

    bl_idname = "roigs.select_roi"
    bl_label = "Select Box"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the box", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Select it, and nothing else."""
        roi = next((r for r in lookup.rois(scene_of(context)) if r.name == self.name), None)
        if roi is None:
            return failed(self, f"There is no box '{self.name}'.")
        _select(context, roi)
        return {"FINISHED"}


def _select(context: bpy.types.Context, roi: bpy.types.Object) -> None:
    """Select it in the panel and in the view layer."""
    scene_props(scene_of(context)).active_roi = roi
    select_only(context, roi)


register, unregister = registration(AddRoi, AddBox, LoadRois, RemoveRoi, SelectRoi)
