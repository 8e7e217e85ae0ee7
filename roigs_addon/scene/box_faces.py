"""Moves the faces of a box, and finds the points around it, in its own frame.

The frame has the box's axes, its centre at 0, and the world's lengths, so that cells in it are
cubes.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..properties import object_props
from . import lookup

Vectors = NDArray[np.float64]
Face = tuple[int, int]
"""The axis of its normal, and whether that points along it (1) or against it (-1)."""

FLATTEST = 1e-3
"""Least side of a box whose face is moved, in its longest side."""


@dataclass(frozen=True)
class Shape:
    """Snapshot of a box. Blender updates `matrix_world` only later.

    Attributes:
        half: half its sides in the world.
        sides: the same in its parent's frame.
        location, scale, delta_scale: the object's own.
        basis: rotation and scale below the parent, after constraints.
    """

    half: Vectors
    sides: Vectors
    location: Vector
    scale: Vector
    delta_scale: Vector
    basis: Matrix

    @classmethod
    def of(cls, roi: bpy.types.Object) -> Shape:
        """Take a snapshot of a box."""
        sides = np.linalg.norm(lookup.matrix_world(roi)[:3, :3], axis=0)
        basis = roi.matrix_basis
        if roi.constraints:
            basis = roi.matrix_parent_inverse.inverted_safe() @ roi.matrix_local
        return cls(
            half=np.asarray(sides * roi.empty_display_size),
            sides=np.array(object_props(roi).half_sides),
            location=roi.location.copy(),
            scale=roi.scale.copy(),
            delta_scale=roi.delta_scale.copy(),
            basis=basis.to_3x3(),
        )

    def restore(self, roi: bpy.types.Object) -> None:
        """Restore the box exactly."""
        roi.location, roi.scale, roi.delta_scale = self.location, self.scale, self.delta_scale


def to_frame(roi: bpy.types.Object, points: Vectors) -> Vectors:
    """Points of the world (N, 3) in the box's frame."""
    world = lookup.matrix_world(roi)
    inverse, sides = lookup.inverse(world, roi.name), np.linalg.norm(world[:3, :3], axis=0)
    return np.asarray((points @ inverse[:3, :3].T + inverse[:3, 3]) * sides)


def set_bounds(roi: bpy.types.Object, shape: Shape, low: Vectors, high: Vectors) -> None:
    """Give the box other bounds in the frame of its shape; it keeps its rotation."""
    centre = (low + high) / 2 / shape.half * roi.empty_display_size
    roi.location = shape.location + shape.basis @ Vector(centre.tolist())
    factors = (high - low) / 2 / shape.half
    object_props(roi).half_sides = (shape.sides * factors).tolist()


def move_face(
    roi: bpy.types.Object,
    shape: Shape,
    face: Face,
    distance: float,
    *,
    both: bool = False,
) -> None:
    """Move a face of the shape outwards by a distance in the world; not past the opposite face.

    Args:
        roi: gets the new bounds.
        shape: the box before.
        face: its axis and side.
        distance: negative moves it inwards.
        both: the opposite face moves too, and the centre stays.
    """
    axis, sign = face
    half = shape.half
    low, high = -half, half.copy()
    room = half[axis] * (1 if both else 2) - half.max() * FLATTEST
    distance = max(distance, -room)
    if sign > 0 or both:
        high[axis] += distance
    if sign < 0 or both:
        low[axis] -= distance
    set_bounds(roi, shape, low, high)


def top(roi: bpy.types.Object) -> Face:
    """The face whose normal is nearest to the world's up."""
    matrix = lookup.matrix_world(roi)[:3, :3]
    rises = matrix[2] / np.linalg.norm(matrix, axis=0)
    axis = int(np.argmax(np.abs(rises)))
    return axis, 1 if rises[axis] >= 0 else -1


def face_matrix(roi: bpy.types.Object, face: Face) -> Matrix:
    """A frame at the centre of a face, in the world; its z axis points outwards."""
    axis, sign = face
    world = Matrix(lookup.matrix_world(roi).tolist())
    normal = world.to_3x3().col[axis].normalized() * sign
    corner = Vector((0, 0, 0))
    corner[axis] = sign * roi.empty_display_size
    rotation = normal.to_track_quat("Z", "Y")
    frame: Matrix = Matrix.Translation(world @ corner) @ rotation.to_matrix().to_4x4()
    return frame
