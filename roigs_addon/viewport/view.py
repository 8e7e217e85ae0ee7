"""The viewpoint of a viewport, and the part of it that the camera's picture fills.

A Gaussian's shape is projected with an approximation that is good in the picture and a little
around it. So in a view through a camera, the camera's frame must limit it, not the region. The
region may be far wider, and large Gaussians beside the picture would then be smeared over it.
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
    """The view to draw Gaussians for.

    Attributes:
        matrix: world -> camera, OpenGL's axes.
        projection: camera -> clip space.
        size: width and height in pixels.
        frame: what the camera's picture fills; None: everything.
    """

    matrix: Matrix
    projection: Matrix
    size: tuple[int, int]
    frame: Frame | None = None


def whole(size: tuple[int, int]) -> Frame:
    """All of a region."""
    return 0.0, 0.0, float(size[0]), float(size[1])


def camera_frame(context: bpy.types.Context, projection: Matrix, size: tuple[int, int]) -> Frame:
    """The picture of the camera that a region looks through; all of the region in other views.

    Args:
        context: of the region that is being drawn.
        projection: camera -> clip space.
        size: of the region, width and height in pixels.
    """
    space, scene = view_3d_of(context), scene_of(context)
    # Of the region: in a quad view, only one of four may look through the camera.
    if space is None or region_view_of(context).view_perspective != "CAMERA":
        return whole(size)
    item = space.camera if space.use_local_camera else scene.camera
    if item is None or not isinstance(item.data, bpy.types.Camera) or item.data.type != "PERSP":
        return whole(size)
    corners = [projection @ corner.to_4d() for corner in item.data.view_frame(scene=scene)]
    across = [(corner.x / corner.w + 1) / 2 * size[0] for corner in corners]
    up = [(corner.y / corner.w + 1) / 2 * size[1] for corner in corners]
    return min(across), min(up), max(across), max(up)
