"""Position of the mouse in the 3D view."""

from __future__ import annotations

import bpy
from bpy_extras import view3d_utils
from mathutils import Vector
from mathutils.geometry import intersect_line_line

from ..blender import region_of, region_view_of


def along(
    context: bpy.types.Context, event: bpy.types.Event, point: Vector, direction: Vector
) -> float:
    """Position of the mouse along a line of the world; 0 where the line is seen end on."""
    region, view = region_of(context), region_view_of(context)
    pixel = event.mouse_region_x, event.mouse_region_y
    eye = view3d_utils.region_2d_to_origin_3d(region, view, pixel)
    ray = view3d_utils.region_2d_to_vector_3d(region, view, pixel)
    found = intersect_line_line(point, point + direction, eye, eye + ray)
    return (found[0] - point).dot(direction) if found else 0.0
