"""Step 1, Scene: place the scene: floor, size, origin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty
from mathutils import Vector

from ..blender import layout_of, registration, scene_of
from ..errors import AddonError
from ..geometry import placing
from ..geometry.frames import Matrix, world_to_camera
from ..properties import scene_props
from ..scene import lookup, placement
from .base import FRESH, NO_CAMERAS, available, box_problem, failed, tell
from .box_tools import checked_box
from .picking import PickTool, selected

if TYPE_CHECKING:
    from ..blender import OperatorResult


def root_problem(context: bpy.types.Context) -> str:
    """Why there is nothing to place; empty if there is."""
    root = scene_props(scene_of(context)).root
    return NO_CAMERAS if root is None or root.name not in scene_of(context).objects else ""


def _place(
    operator: bpy.types.Operator, context: bpy.types.Context, matrix: Matrix, done: str = ""
) -> None:
    """Move the scene, write where it stands, and say so after what was done."""
    scene = scene_of(context)
    if context.mode != "OBJECT":  # an undo step of edit mode holds no objects
        bpy.ops.object.mode_set(mode="OBJECT")
    placement.move(scene, matrix)
    try:
        path = placement.keep(scene)
    except AddonError as error:
        tell(operator, "WARNING", f"Saved in this .blend only: {error}")
    else:
        tell(operator, "INFO", f"{done}Saved in {path}")


class PlaceTool(PickTool):
    """Base of the operators that place the scene by points."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model."""
        return available(cls, root_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Place it; an error becomes a report."""
        try:
            placement.root_of(scene_of(context))
            matrix = self.matrix(context)
            _place(self, context, matrix, self.done(matrix))
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}

    def done(self, matrix: Matrix) -> str:
        """The beginning of the report."""
        return ""

    def matrix(self, context: bpy.types.Context) -> Matrix:
        """(4, 4) to apply to the world; raises AddonError."""
        raise NotImplementedError


class SetFloor(PlaceTool):
    """Level the scene: click three points on its floor, or select more of them in edit mode"""

    bl_idname = "roigs.set_floor"
    bl_label = "Set Floor"
    bl_options = {"REGISTER", "UNDO"}

    wanted = 3
    prompt = "Click points on the floor, far apart"

    first: FloatVectorProperty(name="First Point", subtype="XYZ", options=FRESH)
    second: FloatVectorProperty(name="Second Point", subtype="XYZ", options=FRESH)
    third: FloatVectorProperty(name="Third Point", subtype="XYZ", options=FRESH)
    flip: BoolProperty(
        name="Turn Over", description="The cameras are below the floor", options=FRESH
    )

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Warn of a plane that is a slope or a wall to the cameras."""
        before = self._poses(context)
        result = super().execute(context)
        if result == {"FINISHED"}:
            scene_props(scene_of(context)).has_floor = True
            off = placing.askew(self._matrix, before)
            if off > placing.ASKEW:
                tell(
                    self,
                    "WARNING",
                    f"The floor is {off:.0f}° from level for the cameras. If it is wrong: Ctrl+Z",
                )
        return result

    def done(self, matrix: Matrix) -> str:
        """The rotation, for the report."""
        self._matrix = matrix
        return f"Turned the model by {placing.turn_of(matrix):.0f}°. "

    @staticmethod
    def _poses(context: bpy.types.Context) -> Matrix:
        """(V, 4, 4) of the cameras in the world."""
        cameras = lookup.cameras(scene_of(context)).values()
        places = (lookup.matrix_world(item) for item in cameras)
        poses = [world_to_camera(each, np.eye(4)) for each in places if np.isfinite(each).all()]
        return np.array(poses).reshape(-1, 4, 4)

    def take(self, points: list[Vector]) -> None:
        """Three points."""
        self.first, self.second, self.third = points

    def taken(self) -> bool:
        """Whether they are given."""
        given = self.properties.is_property_set
        return all(given(name) for name in ("first", "second", "third"))

    def matrix(self, context: bpy.types.Context) -> Matrix:
        """Levels the plane through the points."""
        if self.taken():
            points = np.array([self.first, self.second, self.third], float)
        else:
            points = selected(context)
        if len(points) < 3:
            raise AddonError("Select at least three points on the floor in edit mode.")
        plane = placing.plane_through(points)
        if plane is None:
            raise AddonError("These points are on one line. Pick points that span the floor.")
        cameras = lookup.cameras(scene_of(context)).values()
        eyes = np.array([lookup.matrix_world(item)[:3, 3] for item in cameras])
        return placing.levelling(plane, eyes.reshape(-1, 3), flip=self.flip)

    def draw(self, context: bpy.types.Context) -> None:
        """Settings to change afterwards."""
        layout_of(self).prop(self, "flip")


class SetScale(PlaceTool):
    """Give the scene its true size: click two points, or select them in edit mode"""

    bl_idname = "roigs.set_scale"
    bl_label = "Set Scale"
    bl_options = {"REGISTER", "UNDO"}

    wanted = 2
    prompt = "Click two points with a known distance"

    length: FloatProperty(
        name="Length",
        description="Distance between the two points",
        default=1.0,
        min=1e-6,
        precision=4,
        subtype="DISTANCE",
        options=FRESH,
    )
    first: FloatVectorProperty(name="First Point", subtype="XYZ", options=FRESH)
    second: FloatVectorProperty(name="Second Point", subtype="XYZ", options=FRESH)

    def take(self, points: list[Vector]) -> None:
        """Two points."""
        self.first, self.second = points

    def taken(self) -> bool:
        """Whether they are given."""
        given = self.properties.is_property_set
        return bool(given("first") and given("second"))

    def matrix(self, context: bpy.types.Context) -> Matrix:
        """Scales about the world's origin, so a floor at 0 stays there."""
        points = np.array([self.first, self.second]) if self.taken() else selected(context)
        if len(points) != 2:
            raise AddonError(f"Select two points in edit mode, not {len(points)}.")
        found = placing.scaling(points[0], points[1], self.length)
        if found is None:
            raise AddonError("The two points coincide. Pick points that are far apart.")
        return found

    def draw(self, context: bpy.types.Context) -> None:
        """Settings to change afterwards."""
        layout_of(self).prop(self, "length")


class SetOrigin(bpy.types.Operator):
    """Move the world's origin under the object in the active box; a floor you have set is kept"""

    bl_idname = "roigs.set_origin"
    bl_label = "Origin under the Object"
    bl_options = {"REGISTER", "UNDO"}

    keep_height: BoolProperty(
        name="Keep Height",
        description="Keep z = 0, for example at a floor. Otherwise z = 0 is the box's bottom",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model and a box."""
        return available(cls, root_problem(context) or box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Move the scene, not the origin."""
        try:
            placement.root_of(scene_of(context))
            if not self.properties.is_property_set("keep_height"):
                self.keep_height = scene_props(scene_of(context)).has_floor
            roi = checked_box(context)
            size = roi.empty_display_size
            signs = np.stack(np.meshgrid(*[(-size, size)] * 3), axis=-1).reshape(-1, 3)
            world = lookup.matrix_world(roi)
            corners = signs @ world[:3, :3].T + world[:3, 3]
            _place(self, context, placing.centring(corners, keep_height=self.keep_height))
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


class KeepPlacement(bpy.types.Operator):
    """Save the scene's transform beside the model, for other .blend files and the engine"""

    bl_idname = "roigs.keep_placement"
    bl_label = "Keep Placement"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model."""
        return available(cls, root_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Write it."""
        try:
            tell(self, "INFO", f"Saved in {placement.keep(scene_of(context))}")
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


register, unregister = registration(SetFloor, SetScale, SetOrigin, KeepPlacement)
