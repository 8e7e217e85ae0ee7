"""The viewpoint of a viewport, and the camera's frame in it.

A Gaussian's shape is projected with an approximation that is good in the picture and a little
around it. So in a view through a camera, the camera's frame must limit it, not the region. The
region may be much wider, and large Gaussians beside the picture would then be smeared over it.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
from mathutils import Matrix

from ..blender import region_view_of, scene_of, view_3d_of

Frame = tuple[float, float, float, float]
"""Left, bottom, right and top in pixels of the region, from its lower left corner."""


@dataclass(frozen=True)
class View:
    """A view of Gaussians.

    Attributes:
        matrix: world -> camera, OpenGL's axes.
        projection: camera -> clip space.
        size: width and height in pixels.
        frame: area of the camera's picture; None for the whole view.
    """

    matrix: Matrix
    projection: Matrix
    size: tuple[int, int]
    frame: Frame | None = None


def whole(size: tuple[int, int]) -> Frame:
    """Return the whole region as a frame."""
    return 0.0, 0.0, float(size[0]), float(size[1])


def camera_frame(context: bpy.types.Context, projection: Matrix, size: tuple[int, int]) -> Frame:
    """Return the camera's frame in a region that looks through it; in other views, all of it.

    Args:
        context: of the region that is being drawn.
        projection: camera -> clip space.
        size: of the region, width and height in pixels.
    """
    space, scene = view_3d_of(context), scene_of(context)
    # Ask the region's view: in a quad view, only one of four may look through the camera.
    if space is None or region_view_of(context).view_perspective != "CAMERA":
        return whole(size)
    item = space.camera if space.use_local_camera else scene.camera
    if item is None or not isinstance(item.data, bpy.types.Camera) or item.data.type != "PERSP":
        return whole(size)
    corners = [projection @ corner.to_4d() for corner in item.data.view_frame(scene=scene)]
    across = [(corner.x / corner.w + 1) / 2 * size[0] for corner in corners]
    up = [(corner.y / corner.w + 1) / 2 * size[1] for corner in corners]
    return min(across), min(up), max(across), max(up)
