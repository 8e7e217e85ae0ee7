"""Lenses of COLMAP's cameras: their pinholes, and pictures and places without distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import EngineError, SceneError
from ..model.scene import Camera, Float64, PosedImage, project
from .library import pycolmap_module
from .records import ONE_FOCAL, ModelCamera, lens_from_words

# Models that are a pinhole at zero distortion (a fisheye is not) -> index of the first distortion
# parameter.
PINHOLE_AT_ZERO = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 3,
    "RADIAL": 3,
    "OPENCV": 4,
    "FULL_OPENCV": 4,
    "SIMPLE_DIVISION": 3,
    "DIVISION": 4,
}
HINT_RESAMPLE = "Resample its photos to pinhole cameras first."
BORDER = 4  # pixels by which the photo's edge is extended, for interpolation
SIDES, EXACT = (128, 64, 32, 16, 8, 4), 0.01  # pixels: sides of squares; largest error in a square


def as_pinhole(camera: ModelCamera) -> Camera | None:
    """The equivalent pinhole, or None if the camera's photos must be undistorted."""
    first_extra = PINHOLE_AT_ZERO.get(camera.model)
    if first_extra is None or any(camera.params[first_extra:]):
        return None
    return without_distortion(camera)


def without_distortion(camera: ModelCamera) -> Camera:
    """The pinhole with the camera's focal lengths and principal point, ignoring distortion.

    SceneError: the model has no focal length (an equirectangular panorama).
    """
    if camera.model == "EQUIRECTANGULAR":
        raise SceneError("An EQUIRECTANGULAR camera cannot be undistorted.", HINT_RESAMPLE)
    one = camera.model in ONE_FOCAL
    fx, fy, cx, cy = (camera.params[:1] if one else ()) + camera.params[: 3 if one else 4]
    return Camera(width=camera.width, height=camera.height, fx=fx, fy=fy, cx=cx, cy=cy)


def has_pycolmap() -> bool:
    """Whether pycolmap, which undistorts photos, is installed."""
    try:
        _pycolmap()
    except EngineError:
        return False
    return True


def undistorted_mask(mask: NDArray[np.bool_], camera: ModelCamera, least: int) -> NDArray[np.bool_]:
    """As `undistorted_pixels`, for a mask (H, W): pixels covered by at least `least` of 255."""
    grey = np.where(mask, np.uint8(255), np.uint8(0))
    rgb = np.repeat(grey[..., None], 3, axis=2)
    return np.asarray(undistorted_pixels(rgb, camera, sharp=False)[..., 0] >= least)


def undistorted_pixels(
    pixels: NDArray[Any], camera: ModelCamera, *, sharp: bool = True
) -> NDArray[Any]:
    """Undistort a picture of the camera's size, (H, W, 3) uint8 or (H, W) float32.

    `sharp`: cubic interpolation. False: linear, which has no overshoot (for masks), but blurs: half
    a pixel from a pixel's centre it is the mean of 2 x 2.
    """
    from PIL import Image

    pinhole = undistorted_camera(camera)
    border = ((BORDER,) * 2, (BORDER,) * 2, (0, 0))[: pixels.ndim]
    padded = Image.fromarray(np.pad(pixels, border, mode="edge"))
    kernel = Image.Resampling.BICUBIC if sharp else Image.Resampling.BILINEAR
    size = (pinhole.width, pinhole.height)
    flat = padded.transform(size, Image.Transform.MESH, _mesh(camera), kernel)
    del padded  # to free its memory
    return np.asarray(flat)


Quad = tuple[tuple[int, int, int, int], tuple[float, ...]]
"""A square: left, top, right, bottom in the pinhole's picture; and its corners in the padded photo:
x, y of the upper left, lower left, lower right and upper right one."""


@lru_cache(maxsize=16)
def _mesh(camera: ModelCamera) -> list[Quad]:
    """Cut the pinhole's picture into squares; with the places of their corners in the photo.

    Between corners, places are interpolated linearly, which is least exact in the middle. The
    squares are as large as this error allows, because each takes time in Python.
    """
    pinhole = undistorted_camera(camera)
    for side in SIDES:
        columns = [*range(0, pinhole.width, side), pinhole.width]
        rows = [*range(0, pinhole.height, side), pinhole.height]
        places = _places(camera, pinhole, np.array(columns), np.array(rows))
        corners = (places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:])
        middle = _places(camera, pinhole, _between(columns), _between(rows))
        if np.abs(np.mean(corners, axis=0) - middle).max() <= EXACT:
            break
    quads = np.concatenate(corners, axis=2)
    return [
        ((columns[i], rows[j], columns[i + 1], rows[j + 1]), tuple(quads[j, i].tolist()))
        for j in range(len(rows) - 1)
        for i in range(len(columns) - 1)
    ]


def _places(
    camera: ModelCamera, pinhole: Camera, columns: NDArray[Any], rows: NDArray[Any]
) -> Float64:
    """(R, C, 2) places in the padded photo, for a grid of places in the pinhole's picture."""
    x, y = np.meshgrid(columns, rows)
    rays = ((x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy, np.ones(x.shape))
    found = _colmap_camera(camera).img_from_cam(np.stack(rays, axis=-1).reshape(-1, 3))
    return np.asarray(found, np.float64).reshape(*x.shape, 2) + BORDER


def _between(places: Sequence[int]) -> Float64:
    """The middles between successive places."""
    return np.convolve(places, (0.5, 0.5), "valid")


@lru_cache(maxsize=1024)
def undistorted_camera(camera: ModelCamera) -> Camera:
    """The pinhole whose view lies inside the distorted photo (no black borders).

    Its principal point is whole pixels away from the lens's. So pixels hardly change where there is
    hardly any distortion. Up to half a pixel of its border may lie outside.
    SceneError: the camera has no such pinhole.
    """
    try:
        colmap = _pycolmap()
        options = colmap.UndistortCameraOptions(blank_pixels=0.0)
        pinhole = colmap.undistort_camera(options, _colmap_camera(camera))
    except (ValueError, RuntimeError) as error:
        text = f"A {camera.model} camera cannot be undistorted ({error})."
        raise SceneError(text, HINT_RESAMPLE) from error
    fx, fy, cx, cy = (float(value) for value in pinhole.params)
    if pinhole.width < 1 or pinhole.height < 1 or not np.isfinite([fx, fy, cx, cy]).all():
        text = f"A {camera.model} camera with {camera.params} leaves no image area."
        raise SceneError(text, HINT_RESAMPLE)
    centre = without_distortion(camera)
    cx, cy = centre.cx + round(cx - centre.cx), centre.cy + round(cy - centre.cy)
    return Camera(width=pinhole.width, height=pinhole.height, fx=fx, fy=fy, cx=cx, cy=cy)


def undistorted_places(lens: ModelCamera, camera: Camera, places: Float64) -> Float64:
    """(N, 2) places in a distorted photo -> places in its pinhole's picture; may be NaN."""
    rays = np.asarray(_colmap_camera(lens).cam_from_img(np.ascontiguousarray(places)))
    return np.asarray(rays * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def seen_places(lens: ModelCamera, local: Float64) -> Float64:
    """(N, 3) in the camera's axes, z > 0 -> (N, 2) px of the distorted photo; may be NaN.

    Without pycolmap, distortion is ignored.
    """
    pinhole = as_pinhole(lens)
    if pinhole is None and has_pycolmap():
        return np.asarray(_colmap_camera(lens).img_from_cam(np.ascontiguousarray(local)))
    pinhole = pinhole or without_distortion(lens)
    rays = local[:, :2] / local[:, 2:]
    return np.asarray(rays * (pinhole.fx, pinhole.fy) + (pinhole.cx, pinhole.cy))


def photo_places(image: PosedImage, points: Float64) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Project world positions into a photo's file, resampled to the camera's size.

    As `model.scene.project`, but a photo that still has lens distortion shows them through its
    lens. Positions outside the pinhole's picture are not in view.
    """
    places, depth, inside = project(points, image.camera, image.world_to_camera)
    if image.distorted:
        lens, size = lens_from_words(image.lens), (image.camera.width, image.camera.height)
        rows = np.flatnonzero(inside)
        seen = seen_places(lens, image.local(points[rows])) * size / (lens.width, lens.height)
        inside[rows] = ((seen >= 0) & (seen < size)).all(axis=1)  # not NaN either
        places[rows] = seen
    return places, depth, inside


def resized_lens(camera: ModelCamera, width: int, height: int) -> ModelCamera:
    """The same distorted camera for the photo resampled to `width` x `height`."""
    if (width, height) == (camera.width, camera.height):
        return camera
    scaled = _colmap_camera(camera)
    scaled.rescale(width, height)
    params = tuple(float(value) for value in scaled.params)
    return replace(camera, width=width, height=height, params=params)


def _colmap_camera(camera: ModelCamera) -> Any:
    """pycolmap's camera; SceneError if the installed pycolmap does not know the model."""
    colmap = _pycolmap()
    if camera.model not in colmap.CameraModelId.__members__:
        raise SceneError(
            f"{camera.model} cameras are unknown to pycolmap {colmap.__version__}.",
            "Install a newer pycolmap.",
        )
    return colmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=list(camera.params)
    )


def _pycolmap() -> Any:
    return pycolmap_module(
        "Undistorting photos", ", or use a model written by COLMAP's image_undistorter"
    )
