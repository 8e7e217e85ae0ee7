"""Draws the sparse points in their colours, in Solid shading.

In Solid shading, Blender draws all points of an object in one colour, for any attributes and
settings. So a disc of the point's size, a little nearer, covers each point. The object and the
settings of the view stay unchanged. Other shadings show the colours by the points' material.
"""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from mathutils import Matrix

from .. import blender
from ..blender import mesh_of, persistent, region_of, region_view_of, scene_of
from ..scene import clouds, lookup
from . import shaders
from .handler import ViewHandler

SMALLEST = 2.5
"""Least width of a point in pixels, at an interface scale of 1, so that far points stay visible."""

_batches: dict[int, gpu.types.GPUBatch | None] = {}
"""Mesh (`session_uid`) -> its points on the GPU; None if they have no colour."""

_shader: shaders.Shader = None


def problem() -> str:
    """Return why the points cannot be drawn, in one line; empty if they can."""
    return _handler.failure


def draw(
    item: bpy.types.Object,
    view: Matrix,
    projection: Matrix,
    height: int,
    *,
    smallest: float = SMALLEST,
    linear_target: bool = False,
) -> None:
    """Draw an object's points into the bound framebuffer, using its depth.

    Args:
        item: made by `clouds.show_as_points` with one radius for all points.
        view: world -> camera.
        projection: camera -> clip space, perspective or orthographic.
        height: of the framebuffer, pixels.
        smallest: least width of a point, pixels.
        linear_target: the framebuffer takes linear light, as the viewport's; else sRGB values.
    """
    global _shader
    radius, batch = clouds.shown_radius(item), _batch(mesh_of(item))
    if radius is None or batch is None:
        return
    if _shader is None:
        _shader = shaders.point_shader()
    matrix = view @ item.matrix_world
    shader = _shader
    shader.bind()
    shader.uniform_float("model_view", matrix)
    shader.uniform_float("projection", projection)
    size = radius * abs(matrix.to_3x3().determinant()) ** (1 / 3)
    shader.uniform_float("sizes", (size, height, smallest))
    shader.uniform_bool("linear_target", [linear_target])
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)  # Gaussians, drawn later, respect it
    gpu.state.program_point_size_set(True)
    batch.draw(shader)
    gpu.state.program_point_size_set(False)
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def _batch(mesh: bpy.types.Mesh) -> gpu.types.GPUBatch | None:
    """Return the points on the GPU, uploaded once: a million of them take a moment."""
    if mesh.session_uid not in _batches:
        _batches.clear()  # there is one cloud at a time
        _batches[mesh.session_uid] = _uploaded(mesh)
    return _batches[mesh.session_uid]


def _uploaded(mesh: bpy.types.Mesh) -> gpu.types.GPUBatch | None:
    count, colour = len(mesh.vertices), mesh.attributes.get(clouds.COLOUR)
    if not count or colour is None or colour.domain != "POINT":
        return None
    points, light = np.empty((count, 3), np.float32), np.empty((count, 4), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    colour.data.foreach_get("color", light.ravel())
    form = gpu.types.GPUVertFormat()
    form.attr_add(id="point", comp_type="F32", len=3, fetch_mode="FLOAT")
    form.attr_add(id="light", comp_type="F32", len=4, fetch_mode="FLOAT")
    buffer = gpu.types.GPUVertBuf(form, count)
    buffer.attr_fill("point", points)
    buffer.attr_fill("light", light)
    return gpu.types.GPUBatch(type="POINTS", buf=buffer)


def _draw_region(context: bpy.types.Context) -> None:
    space, data = blender.view_3d_of(context), region_view_of(context)
    if space is None or space.shading.type != "SOLID":
        return
    item = lookup.points(scene_of(context))
    if item is None or item.mode == "EDIT" or not item.visible_get(viewport=space):
        return
    draw(
        item,
        data.view_matrix,
        data.window_matrix,
        region_of(context).height,
        smallest=SMALLEST * blender.interface_scale(),
        linear_target=True,
    )


_handler = ViewHandler(_draw_region, "The points' colours cannot be drawn here")


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """After every change, drop the GPU copies of edited points."""
    if not _batches:
        return
    for update in graph.updates:
        if update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            original = update.id.original
            _batches.pop(original.session_uid if original else 0, None)


@persistent
def _on_load(*_: object) -> None:
    """Drop the GPU copies when another file is loaded."""
    _batches.clear()


def register() -> None:
    """Start drawing; in background mode there is no viewport."""
    bpy.app.handlers.depsgraph_update_post.append(_on_change)
    bpy.app.handlers.load_post.append(_on_load)
    _handler.start()


def unregister() -> None:
    """Stop drawing, and free the GPU's memory."""
    global _shader
    _handler.stop()
    bpy.app.handlers.load_post.remove(_on_load)
    bpy.app.handlers.depsgraph_update_post.remove(_on_change)
    _batches.clear()
    _shader = None
