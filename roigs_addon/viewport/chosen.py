"""Marks selected Gaussians as points over the 3D view."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .. import blender
from ..blender import following, mesh_of, persistent, view_layer_of
from ..scene import clouds, point_edits
from ..windows import redraw
from .handler import ViewHandler

COLOUR, WIDTH = (1.0, 0.45, 0.05, 0.6), 2.0
"""Width in pixels, at an interface scale of 1."""

_meshes: set[int] = set()
"""Meshes (`session_uid`) whose selected points are marked."""

_batches: dict[int, gpu.types.GPUBatch | None] = {}
"""Mesh -> its selected points on the GPU; None if there are none."""


def show(items: Iterable[bpy.types.Object]) -> None:
    """Mark the selected points of these objects, and of no others."""
    _meshes.clear()
    _batches.clear()
    _meshes.update(mesh_of(item).session_uid for item in items)
    redraw()


def are_shown(item: bpy.types.Object) -> bool:
    """Whether an object's selected points are marked."""
    return item.data is not None and item.data.session_uid in _meshes


def problem() -> str:
    """Return why the points cannot be drawn, in one line; empty if they can."""
    return _handler.failure


def _draw(context: bpy.types.Context) -> None:
    space = blender.view_3d_of(context)
    if not _meshes or space is None:
        return
    shader = point_shader()
    shader.bind()
    shader.uniform_float("color", COLOUR)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")
    gpu.state.point_size_set(WIDTH * blender.interface_scale())
    for item in view_layer_of(context).objects:
        if are_shown(item) and item.mode == "OBJECT" and item.visible_get(viewport=space):
            batch = _batch(item, shader)
            if batch is not None:
                gpu.matrix.push()
                gpu.matrix.multiply_matrix(item.matrix_world)
                batch.draw(shader)
                gpu.matrix.pop()
    gpu.state.point_size_set(1.0)
    gpu.state.blend_set("NONE")


def point_shader() -> gpu.types.GPUShader:
    """Return the shader for wide points; before Blender 4.5, the usual one draws them."""
    try:
        return gpu.shader.from_builtin("POINT_UNIFORM_COLOR")
    except ValueError:
        return gpu.shader.from_builtin("UNIFORM_COLOR")


def _batch(item: bpy.types.Object, shader: gpu.types.GPUShader) -> gpu.types.GPUBatch | None:
    uid = mesh_of(item).session_uid
    if uid not in _batches:
        points: Any = np.ascontiguousarray(clouds.positions(item)[point_edits.chosen(item)])
        _batches[uid] = batch_for_shader(shader, "POINTS", {"pos": points}) if len(points) else None
    return _batches[uid]


_handler = ViewHandler(_draw, "Chosen Gaussians cannot be marked here")


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """After every change, drop the GPU copies of edited points."""
    for update in graph.updates if _batches else ():
        if update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh):
            original = update.id.original
            _batches.pop(original.session_uid if original else 0, None)


@persistent
def _after_undo(*_: object) -> None:
    _batches.clear()


@persistent
def _after_load(*_: object) -> None:
    _meshes.clear()
    _batches.clear()


_follow, _leave = following(
    ("depsgraph_update_post", _on_change),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("load_post", _after_load),
)


def register() -> None:
    """Start drawing; in background mode there is no viewport."""
    _follow()
    _handler.start()


def unregister() -> None:
    """Stop drawing."""
    _handler.stop()
    _leave()
    _after_load()
