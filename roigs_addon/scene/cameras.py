"""Photos as Blender cameras, and back."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix as BlenderMatrix

from ..blender import camera_of
from ..geometry import frames
from ..geometry.frames import Intrinsics, Lens, Matrix
from ..geometry.photo import Photo
from ..properties import object_props
from . import backgrounds, lookup

ORTHO_BACK = 2000.0
"""Distance of the pinhole camera that stands for an orthographic one, in widths of its picture. At
the picture's edges, an object as deep as the picture is wide moves by a 4,000th of the picture."""
LEAST_CLIP = 1e-6
"""Blender's smallest clip distance."""


def new_camera(photo: Photo, size: float) -> bpy.types.Object:
    """A camera object below the root, in the COLMAP frame; not linked to any collection yet.

    Args:
        photo: the camera's photo.
        size: display size in the viewport.
    """
    data = bpy.data.cameras.new(photo.name)
    lens = frames.lens_from_intrinsics(photo.intrinsics)
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = frames.SENSOR_WIDTH
    data.lens, data.shift_x, data.shift_y = lens.lens, lens.shift_x, lens.shift_y
    data.display_size = size
    data.clip_start, data.clip_end = _clips(size, 1.0)
    item = bpy.data.objects.new(photo.name, data)
    item.matrix_local = BlenderMatrix(frames.camera_matrix(photo.pose).tolist())
    props = object_props(item)
    props.kind, props.photo = "CAMERA", photo.to_json()
    return item


def fit_clips(scene: bpy.types.Scene, scale: float) -> None:
    """Set all photo cameras' clip ranges for a scale of the root; Blender does not scale them."""
    for item in (*lookup.of_kind(scene, "CAMERA"), *lookup.of_kind(scene, "SHOT")):
        _fit_clip(camera_of(item), scale)


def _fit_clip(data: bpy.types.Camera, scale: float) -> None:
    """Set a clip range for a scale, unless the user has changed it."""
    start, _ = _clips(data.display_size, data.clip_end / _clips(data.display_size, 1.0)[1])
    if abs(data.clip_start - start) <= 1e-3 * start:
        data.clip_start, data.clip_end = _clips(data.display_size, scale)


def _clips(size: float, scale: float) -> tuple[float, float]:
    return max(LEAST_CLIP, size * scale * 1e-2), max(LEAST_CLIP, size * scale * 1e4)


def activate(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Make the scene render what this camera's photo shows, with its resolution and pixel aspect.

    Its photo is loaded as the camera's background only now: loading a thousand photos at import
    would fill the memory. For the same reason the photos behind other cameras are freed.
    """
    photo = lookup.photo_record(item)
    scene.camera = item
    if photo is None:
        return
    _fit_clip(camera_of(item), lookup.root_scale(scene))  # the root may be scaled by hand
    k, render = photo.intrinsics, scene.render
    lens = frames.lens_from_intrinsics(k)
    render.resolution_x, render.resolution_y = k.width, k.height
    render.pixel_aspect_x, render.pixel_aspect_y = lens.aspect_x, lens.aspect_y
    backgrounds.show(camera_of(item), photo)
    backgrounds.follow(scene)
    _free_others(scene, camera_of(item))


def _free_others(scene: bpy.types.Scene, shown: bpy.types.Camera) -> None:
    """Free the pixels of other cameras' photos; Blender reads a photo again when it draws it."""
    kept = {background.image for background in shown.background_images}
    for camera in lookup.of_kind(scene, "CAMERA"):
        for background in camera_of(camera).background_images:
            image = background.image
            if image is not None and image not in kept and not image.is_dirty:
                image.buffers_free()
                image.gl_free()


def photo_of(item: bpy.types.Object, root: bpy.types.Object | None) -> Photo | None:
    """Return a camera object's photo with its present pose in the COLMAP frame.

    If the camera was not moved against its root, this is exactly the stored record. A moved camera
    has Blender's 32-bit precision.
    """
    photo = lookup.photo_record(item)
    if photo is None:
        return None
    pose = frames.world_to_camera(lookup.matrix_world(item), lookup.matrix_world(root))
    if _same(pose, photo.pose):
        return photo
    rows = tuple(tuple(float(v) for v in row) for row in pose)
    return replace(photo, world_to_camera=rows)


def _same(a: Matrix, b: Matrix) -> bool:
    scale = 1.0 + float(np.abs(b[:3, 3]).max())
    return bool(np.abs(a - b).max() < 1e-4 * scale)


def render_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height of a render in pixels; rounded down, as Blender does."""
    share = render.resolution_percentage
    return max(1, render.resolution_x * share // 100), max(1, render.resolution_y * share // 100)


def intrinsics_of(
    data: bpy.types.Camera, render: bpy.types.RenderSettings, width: int, height: int
) -> Intrinsics:
    """Return a Blender camera's pinhole intrinsics in pixels, for any sensor fit; no panoramas.

    An orthographic camera becomes a pinhole camera `ORTHO_BACK` times its scale behind it.
    """
    aspect_x, aspect_y = render.pixel_aspect_x, render.pixel_aspect_y
    wide = width * aspect_x >= height * aspect_y
    fit = data.sensor_fit
    along_x = wide if fit == "AUTO" else fit == "HORIZONTAL"
    sensor = data.sensor_height if fit == "VERTICAL" else data.sensor_width
    unit = 1.0 if along_x else (height * aspect_y) / (width * aspect_x)
    # The focal length in widths of the image.
    per_width = unit * (ORTHO_BACK if data.type == "ORTHO" else data.lens / sensor)
    lens = Lens(
        lens=per_width * frames.SENSOR_WIDTH,
        shift_x=data.shift_x * unit,
        shift_y=data.shift_y * unit,
        aspect_x=aspect_x,
        aspect_y=aspect_y,
    )
    return frames.intrinsics_from_lens(lens, width, height)
