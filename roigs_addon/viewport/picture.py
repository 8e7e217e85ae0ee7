"""Draws a picture of a 3D view with its Gaussians, in the render's size.

Blender's own pictures of a view (View ▸ Viewport Render Image) have no Gaussians, because Blender
calls no draw handlers for them.
"""

from __future__ import annotations

from typing import Any

import bpy
import gpu
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..blender import region_view_of, scene_of, view_3d_of, view_layer_of
from ..errors import AddonError
from ..scene.cameras import render_size
from . import targets
from .draw import painter
from .objects import splat_objects, surfaces_are_visible
from .view import View, camera_frame

KEY = "picture"
"""Key of the order for pictures, instead of a viewport's."""

MOST_PIXELS = 1 << 26
"""Largest picture. It takes about 8 GB in Blender; with more, the system may end Blender."""


def view_picture(context: bpy.types.Context) -> NDArray[np.float32]:
    """(H, W, 4) picture of a context's 3D view, with full Gaussians; bottom row first.

    Raises:
        RuntimeError: the GPU has no memory for a picture of this size.
        AddonError: the picture is too large, or the camera sees nothing.
    """
    scene, space, region = scene_of(context), view_3d_of(context), context.region
    assert space is not None and region is not None
    size = checked(render_size(scene.render), gpu.capabilities.max_texture_size_get())
    matrix, projection = _view(context, size)
    made: Any = targets.TYPES.GPUOffScreen(*size, format="RGBA16F")
    try:
        made.draw_view3d(
            scene,
            view_layer_of(context),
            space,
            region,
            matrix,
            projection,
            do_color_management=True,
        )
        with made.bind():
            framebuffer: Any = targets.STATE.active_framebuffer_get()
            painter().draw(
                splat_objects(context),
                View(matrix, projection, size, camera_frame(context, projection, size)),
                key=KEY,
                depth=targets.bound_depth(*size) if surfaces_are_visible(context) else None,
                wait=True,
            )
            pixels = framebuffer.read_color(0, 0, *size, 4, 0, "FLOAT")
    finally:
        made.free()
    pixels.dimensions = 4 * size[0] * size[1]
    picture: NDArray[np.float32] = np.asarray(pixels, np.float32).reshape(size[1], size[0], 4)
    return picture


def checked(size: tuple[int, int], across: int) -> tuple[int, int]:
    """Return the size; AddonError if it is too large, or wider or higher than `across`."""
    if max(size) > across or size[0] * size[1] > MOST_PIXELS:
        raise AddonError(
            f"A picture of {size[0]} x {size[1]} pixels is too large."
            " Lower the resolution in the Output properties."
        )
    return size


def pose(item: bpy.types.Object) -> Matrix:
    """Return world -> camera; AddonError if the object's scale is zero."""
    try:
        matrix: Matrix = item.matrix_world.normalized().inverted()
    except ValueError as error:
        raise AddonError(f"The camera '{item.name}' sees nothing: its scale is zero.") from error
    return matrix


def _view(context: bpy.types.Context, size: tuple[int, int]) -> tuple[Matrix, Matrix]:
    """Return world -> camera and camera -> clip space, of the camera or of a view in this size."""
    data, space, scene = region_view_of(context), view_3d_of(context), scene_of(context)
    assert space is not None
    item = space.camera if space.use_local_camera else scene.camera
    if data.view_perspective == "CAMERA" and item is not None:
        found = item.evaluated_get(context.evaluated_depsgraph_get())
        projection = found.calc_matrix_camera(
            context.evaluated_depsgraph_get(),
            x=size[0],
            y=size[1],
            scale_x=scene.render.pixel_aspect_x,
            scale_y=scene.render.pixel_aspect_y,
        )
        return pose(found), projection
    region = context.region
    assert region is not None
    projection = data.window_matrix.copy()
    for row, (now, wanted) in enumerate(zip((region.width, region.height), size, strict=True)):
        # The longer side of a view shows the same extent for any size.
        now_share = now / max(region.width, region.height)
        projection[row] *= now_share / (wanted / max(size))
    return data.view_matrix.copy(), projection
