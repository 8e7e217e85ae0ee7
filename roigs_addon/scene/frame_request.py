"""The content of a frame: the Gaussian objects, their places, and the camera."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from typing import Any

import bpy
import numpy as np

from ..blender import camera_of
from ..errors import AddonError
from ..geometry import frames, panorama
from . import cameras, display, edits, instances, ladders, look, lookup, panoramas

Model = dict[str, Any]
"""An object of a request: its file, matrix, gains and object index."""


def frame_request(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, out: str
) -> dict[str, Any] | None:
    """Return the engine's request for a frame (docs/files.md); None if it shows no Gaussians.

    Args:
        scene: the rendered scene.
        depsgraph: of the frame. Only it has animated objects in their places of this frame.
        out: path of the engine's files.

    Raises:
        AddonError: the engine cannot render this kind of camera, or an object has no valid place.
    """
    own = (item for item in shown(scene) if not display.is_native(item))
    more = (i for i in instances.instances(depsgraph) if not display.is_native(i.item))
    whole = [*_models(own, depsgraph), *_more(more)]
    if not whole or scene.camera is None:
        return None
    camera = scene.camera.evaluated_get(depsgraph)
    # Blender lets any object be the camera.
    around = camera.type == "CAMERA" and panoramas.is_drawn(camera_of(camera), scene)
    if camera.type != "CAMERA" or not (around or camera_of(camera).type in ("PERSP", "ORTHO")):
        raise AddonError(
            "The render lacks the Gaussians: its camera is neither perspective nor orthographic,"
            " nor an equirectangular panorama or a fisheye of Cycles."
        )
    data = camera_of(camera)
    matrix = lookup.stands(scene.camera, depsgraph)
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise AddonError("The render lacks the Gaussians: a scale of the camera is zero.")
    lens = cameras.intrinsics_of(data, scene.render, *cameras.render_size(scene.render))
    if around:
        lens = replace(lens, fx=(density := panoramas.density(data, scene.render)), fy=density)
    pose = frames.world_to_camera(matrix, np.eye(4))
    if data.type == "ORTHO":
        pose[2, 3] += cameras.ORTHO_BACK * data.ortho_scale
    # For the whole picture, so that a region of it looks the same.
    to_clip, focal = frames.clip_matrix(lens) @ pose, max(lens.fx, lens.fy)
    models = []
    for item, model in whole:
        detail = ladders.of(item, scene)
        if around or detail is None or not all(map(os.path.isfile, detail.files)):
            models.append(model)
            continue
        drawn = detail.shown(np.array(model["matrix"]), to_clip, focal)
        models += [{**model, "ply": detail.files[k], "density": f} for k, f in drawn.items()]
    left, top, width, height = picture(scene.render)
    lens = replace(lens, width=width, height=height, cx=lens.cx - left, cy=lens.cy - top)
    record = {"name": str(scene.frame_current), **asdict(lens), "world_to_camera": pose.tolist()}
    return {"camera": record, "models": models, "out": out}


def rays(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> panorama.Rays | None:
    """(H, W, 3) directions of a panorama's pixels in the camera's frame; None for other cameras."""
    if scene.camera is None or scene.camera.type != "CAMERA":
        return None
    data = camera_of(scene.camera.evaluated_get(depsgraph))
    return (
        panoramas.rays(data, scene.render, picture(scene.render)) if data.type == "PANO" else None
    )


def models_of(
    items: Iterable[bpy.types.Object],
    more: Iterable[instances.Instance],
    depsgraph: bpy.types.Depsgraph,
) -> list[Model]:
    """Return the objects not hidden in renders, with their edits, looks and places.

    They are whole, not at a level of detail.

    Args:
        items: the objects.
        more: their instances.
        depsgraph: has their places.

    Raises:
        AddonError: one of them has no valid place.
    """
    return [model for _, model in (*_models(items, depsgraph), *_more(more))]


def _models(
    items: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, Model]]:
    for item, moved, matrix in standing(items, depsgraph):
        edits.look_again(item)
        if ply := edits.file_of(item):
            yield item, _model(item, ply, matrix, moved)


def _more(
    found: Iterable[instances.Instance],
) -> Iterator[tuple[bpy.types.Object, Model]]:
    files: dict[bpy.types.Object, str] = {}
    for each in found:
        if each.item not in files:
            edits.look_again(each.item)
            files[each.item] = edits.file_of(each.item)
        if ply := files[each.item]:
            yield each.item, _model(each.item, ply, each.matrix, each.item)


def _model(
    item: bpy.types.Object, ply: str, matrix: frames.Matrix, shown_as: bpy.types.Object
) -> Model:
    placed = matrix @ edits.frame_of(item)
    own = {"gains": look.gains(shown_as), "object_index": shown_as.pass_index}
    return {"ply": ply, "matrix": placed.tolist(), **own}


def standing(
    items: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, bpy.types.Object, frames.Matrix]]:
    """Yield each object not hidden in renders, its evaluated object, and its matrix in the world.

    Raises:
        AddonError: one of them has no valid place.
    """
    for item in items:
        moved = item.evaluated_get(depsgraph)
        if moved.hide_render:
            continue
        matrix = lookup.stands(item, depsgraph)
        if np.linalg.matrix_rank(matrix[:3, :3]) == 3:  # else scaled to 0
            yield item, moved, matrix


def picture(render: bpy.types.RenderSettings) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the picture in the frame, in pixels.

    It is the render region if the render is cropped to it.
    """
    width, height = cameras.render_size(render)
    if not (render.use_border and render.use_crop_to_border):
        return 0, 0, width, height
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    return left, height - top, max(1, right - left), max(1, top - bottom)


def shown(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects in rendered collections that are drawn as Gaussians."""
    layers = [layer for layer in scene.view_layers if layer.use]
    seen = {item for layer in layers for item in _of(layer.layer_collection)}
    return [item for item in lookup.splats(scene) if item in seen and instances.is_drawn(item)]


def _of(layer: bpy.types.LayerCollection) -> set[bpy.types.Object]:
    """Objects of the collections that a view layer renders."""
    if layer.exclude or layer.collection.hide_render:
        return set()
    found = set(layer.collection.objects)
    return found.union(*map(_of, layer.children))
