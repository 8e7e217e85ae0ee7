"""Photos as Blender cameras, and back."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix as BlenderMatrix

from . import frames, lookup
from .frames import Intrinsics, Lens, Matrix
from .photo import Photo


def new_camera(photo: Photo, size: float) -> bpy.types.Object:
    """A camera object below the root, in the COLMAP frame; not linked to any collection yet.

    Args:
        photo: what it shows.
        size: of its drawing in the viewport.
    """
    data = bpy.data.cameras.new(photo.name)
    lens = frames.lens_from_intrinsics(photo.intrinsics)
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = frames.SENSOR_WIDTH
    data.lens, data.shift_x, data.shift_y = lens.lens, lens.shift_x, lens.shift_y
    data.display_size = size
    data.clip_start, data.clip_end = size * 1e-2, size * 1e4
    item = bpy.data.objects.new(photo.name, data)
    item.matrix_local = BlenderMatrix(frames.camera_matrix(photo.pose).tolist())
    item.roigs.kind = "CAMERA"
    item.roigs.photo = photo.to_json()
    return item


def activate(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Make the scene render as this camera's photo: resolution and pixel aspect are the scene's.

    Its photo is loaded as the camera's background now: a thousand photos at import would fill the
    memory.
    """
    photo = Photo.from_json(item.roigs.photo)
    scene.camera = item
    if photo is None:
        return
    k, render = photo.intrinsics, scene.render
    lens = frames.lens_from_intrinsics(k)
    render.resolution_x, render.resolution_y = k.width, k.height
    render.pixel_aspect_x, render.pixel_aspect_y = lens.aspect_x, lens.aspect_y
    show_background(item.data, photo)


def show_background(data: bpy.types.Camera, photo: Photo) -> None:
    """Load the photo behind the camera's view, unless it is there or cannot be read."""
    if not photo.path or len(data.background_images):
        return
    try:
        image = bpy.data.images.load(photo.path, check_existing=True)
    except RuntimeError:  # missing, or no picture: the camera is of use without it
        return
    background = data.background_images.new()
    background.image = image
    background.frame_method = "STRETCH"
    background.alpha = 1.0
    background.display_depth = "BACK"
    data.show_background_images = True


def photo_of(item: bpy.types.Object, root: bpy.types.Object | None) -> Photo | None:
    """The photo of a camera object as COLMAP would have it now.

    As long as nobody moved the camera against its root, that is the record to the last digit; a
    moved one has Blender's 32-bit precision.
    """
    photo = Photo.from_json(item.roigs.photo)
    if photo is None:
        return None
    pose = frames.world_to_camera(lookup.matrix_world(item), lookup.matrix_world(root))
    if _same(pose, photo.pose):
        return photo
    rows = tuple(tuple(float(v) for v in row) for row in pose)
    return Photo(
        name=photo.name, path=photo.path, intrinsics=photo.intrinsics, world_to_camera=rows
    )


def _same(a: Matrix, b: Matrix) -> bool:
    scale = 1.0 + float(np.abs(b[:3, 3]).max())
    return bool(np.abs(a - b).max() < 1e-4 * scale)


def scene_camera(scene: bpy.types.Scene, root: bpy.types.Object | None) -> Photo | None:
    """The scene's active camera at the scene's resolution, as a camera of the COLMAP frame.

    An untouched photo's camera at its photo's size is that of COLMAP to the last digit. None when
    there is none, or it is not a perspective camera.
    """
    item = scene.camera
    if item is None or item.data.type != "PERSP":
        return None
    render, data = scene.render, item.data
    # Rounded down, as Blender does it.
    width = max(1, render.resolution_x * render.resolution_percentage // 100)
    height = max(1, render.resolution_y * render.resolution_percentage // 100)
    intrinsics = intrinsics_of(data, render, width, height)
    photo = photo_of(item, root)
    if photo is None:
        pose = frames.world_to_camera(lookup.matrix_world(item), lookup.matrix_world(root))
        rows = tuple(tuple(float(v) for v in row) for row in pose)
    else:
        rows = photo.world_to_camera
        if _same_lens(intrinsics, photo.intrinsics):
            intrinsics = photo.intrinsics
    return Photo(
        name=f"{scene.frame_current:04d}", path="", intrinsics=intrinsics, world_to_camera=rows
    )


def _same_lens(a: Intrinsics, b: Intrinsics) -> bool:
    if (a.width, a.height) != (b.width, b.height):
        return False
    pairs = ((a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy))
    return all(abs(one - other) < 1e-5 * max(a.width, a.height) for one, other in pairs)


def intrinsics_of(
    data: bpy.types.Camera, render: bpy.types.RenderSettings, width: int, height: int
) -> Intrinsics:
    """The pinhole camera in pixels of any perspective Blender camera, whatever its sensor fit."""
    aspect_x, aspect_y = render.pixel_aspect_x, render.pixel_aspect_y
    wide = width * aspect_x >= height * aspect_y
    fit = data.sensor_fit
    if fit == "AUTO":
        sensor, along_x = data.sensor_width, wide
    else:
        along_x = fit == "HORIZONTAL"
        sensor = data.sensor_width if along_x else data.sensor_height
    if along_x:
        per_width = data.lens / sensor  # focal length in widths of the image
        unit = 1.0
    else:
        per_width = data.lens / sensor * (height * aspect_y) / (width * aspect_x)
        unit = (height * aspect_y) / (width * aspect_x)
    lens = Lens(
        lens=per_width * frames.SENSOR_WIDTH,
        shift_x=data.shift_x * unit,
        shift_y=data.shift_y * unit,
        aspect_x=aspect_x,
        aspect_y=aspect_y,
    )
    return frames.intrinsics_from_lens(lens, width, height)
