"""Step 2, Boxes: fit a box to its content."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, IntProperty
from numpy.typing import NDArray

from ..blender import registration, scene_of
from ..errors import AddonError
from ..geometry import fitting
from ..scene import box_faces, clouds, lookup, rois
from . import mouse
from .base import FRESH, NO_BOX, available, box_problem, failed, tell

if TYPE_CHECKING:
    from ..blender import OperatorResult

SLOWLY = 0.1


class BoxTool(bpy.types.Operator):
    """Base of the operators that change the active box."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Change it; an error becomes a report."""
        try:
            self.change(checked_box(context), context)
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}

    def change(self, roi: bpy.types.Object, context: bpy.types.Context) -> None:
        """Do it; raises AddonError."""
        raise NotImplementedError


def checked_box(context: bpy.types.Context) -> bpy.types.Object:
    """The active box.

    Raises:
        AddonError: there is none, or it is slanted or flat.
    """
    roi = lookup.active_roi(context)
    if roi is None:
        raise AddonError(f"{NO_BOX}.")
    lookup.box(roi, scene_of(context))
    return roi


class FitToPoints(BoxTool):
    """Fit the active box tightly around the selected points, or those in it, without outliers"""

    bl_idname = "roigs.fit_box"
    bl_label = "Fit to Points"
    bl_options = {"REGISTER", "UNDO"}

    def change(self, roi: bpy.types.Object, context: bpy.types.Context) -> None:
        """Move its faces; it keeps its rotation."""
        shape, edited = box_faces.Shape.of(roi), context.active_object
        if context.mode == "EDIT_MESH" and edited is not None:
            edited.update_from_editmode()
            placed = box_faces.to_frame(roi, rois.selected_vertices(edited))
            bpy.ops.object.mode_set(mode="OBJECT")
            bounds = fitting.tight(placed)
            where = "selected. Select more"
        else:
            placed = box_faces.to_frame(roi, _sparse_points(scene_of(context)))
            placed = placed[(np.abs(placed) <= shape.half).all(axis=1)]
            bounds = fitting.tight(placed, shape.half)
            where = f"in '{roi.name}'. Enlarge or move it"
        if bounds is None:
            raise AddonError(f"There are too few points {where}.")
        box_faces.set_bounds(roi, shape, *bounds)
        if fitting.is_unsure(placed):
            tell(self, "WARNING", f"Fitted to {len(placed)} points only: check each face")


class SnapToFloor(BoxTool):
    """Move the bottom of the active box to the floor or table that the object stands on"""

    bl_idname = "roigs.snap_box"
    bl_label = "Snap to Floor"
    bl_options = {"REGISTER", "UNDO"}

    def change(self, roi: bpy.types.Object, context: bpy.types.Context) -> None:
        """Find the height that most points around the box have."""
        shape, (axis, sign) = box_faces.Shape.of(roi), box_faces.top(roi)
        placed = box_faces.to_frame(roi, _sparse_points(scene_of(context)))
        height = fitting.floor(placed, shape.half, axis, sign)
        if height is None:
            raise AddonError(
                f"There are too few points around and below '{roi.name}'. Move its bottom by hand."
            )
        below = -sign * height - shape.half[axis]
        box_faces.move_face(roi, shape, (axis, -sign), below)


def _sparse_points(scene: bpy.types.Scene) -> NDArray[np.float64]:
    """(N, 3) in the world."""
    cloud = lookup.points(scene)
    if cloud is None:
        raise AddonError("There are no sparse points. Reconstruct photos or import cameras first.")
    world = lookup.matrix_world(cloud)
    return np.asarray(clouds.positions(cloud) @ world[:3, :3].T + world[:3, 3])


class MoveFace(BoxTool):
    """Move one face of the active box. Shift: slowly. Ctrl: the opposite face too"""

    bl_idname = "roigs.move_face"
    bl_label = "Move Face"
    bl_options = {"REGISTER", "UNDO", "BLOCKING"}

    axis: IntProperty(name="Axis", min=0, max=2, description="0 to 2: X, Y, Z", options=FRESH)
    sign: IntProperty(name="Side", default=1, min=-1, max=1, options=FRESH)
    distance: FloatProperty(
        name="Distance", description="Outwards", subtype="DISTANCE", options=FRESH
    )
    both: BoolProperty(name="Both Sides", description="The opposite face too", options=FRESH)

    def change(self, roi: bpy.types.Object, context: bpy.types.Context) -> None:
        """Move it by a distance."""
        self._move(roi, box_faces.Shape.of(roi))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Follow the mouse from here, along the face's normal."""
        try:
            roi = checked_box(context)
        except AddonError as error:
            return failed(self, error)
        self._roi, self._shape = roi.name, box_faces.Shape.of(roi)
        frame = box_faces.face_matrix(roi, (self.axis, 1 if self.sign > 0 else -1))
        self._line = frame.translation.copy(), frame.to_3x3().col[2].copy()
        self._last = mouse.along(context, event, *self._line)
        self.distance = 0.0
        assert context.window_manager is not None
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Move with the mouse until its button is released; Esc and the right button undo it."""
        roi = scene_of(context).objects.get(self._roi)
        if roi is None:
            return {"CANCELLED"}
        if event.type == "MOUSEMOVE":
            at = mouse.along(context, event, *self._line)
            self.distance += (at - self._last) * (SLOWLY if event.shift else 1.0)
            self._last, self.both = at, event.ctrl
            self._move(roi, self._shape)
        elif event.type in {"ESC", "RIGHTMOUSE"}:
            self._shape.restore(roi)
            return {"CANCELLED"}
        elif event.type in {"LEFTMOUSE", "RET", "NUMPAD_ENTER"}:
            return {"FINISHED"}
        return {"RUNNING_MODAL"}

    def _move(self, roi: bpy.types.Object, shape: box_faces.Shape) -> None:
        face = self.axis, 1 if self.sign > 0 else -1
        box_faces.move_face(roi, shape, face, self.distance, both=self.both)


register, unregister = registration(FitToPoints, SnapToFloor, MoveFace)
