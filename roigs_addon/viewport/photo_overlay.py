"""Draws a photo with a box's strokes and mask, over a view through the photo's camera.

Gaussians would hide Blender's background photo, so this draws it again over them. Images are read
outside of drawing, where Blender allows it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from numpy.typing import NDArray

from ..blender import load_image, region_of, region_view_of, scene_of, view_3d_of
from ..geometry.photo_places import Frame, in_region, unit
from ..jobs import run_folders
from ..properties import scene_props
from ..scene import backgrounds, lookup, masks, scribbles
from ..windows import Timer, redraw
from . import targets
from .handler import ViewHandler
from .view import camera_frame

MASK = (1.0, 0.1, 0.8, 0.45)
COLOURS = {scribbles.OBJECT: (0.15, 0.95, 0.3, 1.0), scribbles.BACKGROUND: (1.0, 0.25, 0.15, 1.0)}
SIDE = 1536
"""Longest side of drawn images, in pixels; of larger images, rows and columns are left out."""

Key = tuple[str, int]
"""Path and modification time of a file."""

_textures: dict[Key, Any] = {}
_wanted: dict[Key, bool] = {}
"""Files to read; True for masks."""

drawing: tuple[str, list[tuple[float, float]], float] | None = None
"""The stroke being drawn: its kind, points and width in pixels of the photo."""


def show_stroke(kind: str, points: list[tuple[float, float]], width: float) -> None:
    """Show an unfinished stroke."""
    global drawing
    drawing = kind, points, width


def hide_stroke() -> None:
    """Hide the unfinished stroke."""
    global drawing
    drawing = None


def frame_of(context: bpy.types.Context) -> Frame | None:
    """Return the photo's frame in a region; None if the region shows no photo's camera."""
    space, region = view_3d_of(context), context.region
    if space is None or region is None or context.region_data is None:
        return None
    view = region_view_of(context)
    if view.view_perspective != "CAMERA" or masks.photo_at_hand(context) is None:
        return None
    return camera_frame(context, view.window_matrix, (region.width, region.height))


def _draw(context: bpy.types.Context) -> None:
    scene = scene_of(context)
    if not scene_props(scene).show_masks:
        return
    roi, photo, frame = lookup.active_roi(context), masks.photo_at_hand(context), frame_of(context)
    if roi is None or photo is None or frame is None:
        return
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("ALPHA")
    image(texture(backgrounds.with_distortion(photo)), frame)
    mask = masks.file(scene, run_folders.run_folder(scene), roi, photo.name)
    image(mask and texture(mask, mask=True), frame)
    size = masks.size_of(photo)
    drawn = [(s["kind"], s["points"], s["width"]) for s in scribbles.strokes(roi, photo.name)]
    for kind, points, width in [*drawn, *([drawing] if drawing else [])]:
        _line(region_of(context), in_region(points, frame, size), width / unit(frame, size), kind)
    gpu.state.blend_set("NONE")


def _line(region: bpy.types.Region, places: NDArray[Any], width: float, kind: str) -> None:
    if len(places) == 1:
        places = np.vstack([places, places[0] + np.array([max(1.0, width / 2), 0.0])])
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    ends = [(float(x), float(y), 0.0) for x, y in places]
    batch = batch_for_shader(shader, "LINE_STRIP", {"pos": ends})
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", min(max(width, 2.0), 10.0))
    shader.uniform_float("color", COLOURS.get(kind, (1.0, 1.0, 1.0, 1.0)))
    batch.draw(shader)


def image(texture: Any, frame: Frame, share: float = 1.0) -> None:
    """Fill the left `share` of the frame with a texture; do nothing for None."""
    if texture is None or share <= 0:
        return
    left, bottom, right, top = frame
    right = left + share * (right - left)
    shader = gpu.shader.from_builtin("IMAGE")
    corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
    content: Any = {"pos": corners, "texCoord": [(0, 0), (share, 0), (share, 1), (0, 1)]}
    batch = batch_for_shader(shader, "TRI_FAN", content)
    shader.bind()
    shader.uniform_sampler("image", texture)
    batch.draw(shader)


def texture(path: Path, *, mask: bool = False) -> Any:
    """Return the texture of a file; None if there is no file, or it is not read yet."""
    try:
        key = os.fspath(path), os.stat(path).st_mtime_ns
    except OSError:
        return None
    if key not in _textures and key not in _wanted:
        _wanted[key] = mask
        _reader.start()
    found = _textures.get(key)
    if isinstance(found, np.ndarray):
        found = _textures[key] = targets.texture(found, "RGBA16F")
    return found


def _read() -> bool:
    """Read the wanted files; keep only the last few textures."""
    for key, mask in [*_wanted.items()]:
        pixels = _pixels(Path(key[0]))
        if mask and pixels is not None:
            bright = (pixels[..., :3] > 0).any(axis=2) & (pixels[..., 3] >= 0.5)
            pixels = np.where(bright[..., None], np.array(MASK, np.float32), np.float32(0))
        _textures[key] = pixels
        while len(_textures) > 4:
            _textures.pop(next(iter(_textures)))
        _wanted.pop(key, None)
    redraw()
    return False


def _pixels(path: Path) -> NDArray[np.float32] | None:
    """(H, W, 4) stored values of an image file, bottom row first; None if it is not an image."""
    image: Any = load_image(path)
    if image is None:
        return None
    try:
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        if not width or not height:
            return None
        flat = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(flat)
        step = max(1, -(-max(width, height) // SIDE))
        return flat.reshape(height, width, 4)[::step, ::step]
    finally:
        bpy.data.images.remove(image)


_handler = ViewHandler(_draw, "Masks cannot be drawn here", after="POST_PIXEL")
_reader = Timer(_read, 0.01)
problem, register = _handler.problem, _handler.start


def unregister() -> None:
    """Stop drawing, and free the textures."""
    _handler.stop()
    _reader.stop()
    _textures.clear()
    _wanted.clear()
    hide_stroke()
