"""Undistorts photos to pinhole cameras, in parallel, into a cache."""

from __future__ import annotations

import atexit
import hashlib
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import EngineError, SceneError
from ..formats.files import atomic_write, cannot_write, own_folder
from ..formats.run_files import UNDISTORTED
from ..formats.scratch import new_scratch, remove_scratch
from ..formats.text import in_gb
from ..machine import ENGINE, disk_message, machine_memory, release_freed_memory
from ..model.scene import Camera, Float64, PosedImage
from ..photos.headers import PhotoError, check_unchanged
from ..photos.parallel import decoding_bytes, in_parallel, threads_for
from ..photos.rotation import AS_STORED
from .library import pycolmap_module
from .records import ONE_FOCAL, ModelCamera

# Models that are a pinhole if their distortion is zero (a fisheye is not), and the index of their
# first distortion parameter.
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
# Photos are undistorted at full size, or at this multiple of a much smaller target size.
OVERSAMPLING = 2.0
HINT_RESAMPLE = "Resample its photos to pinhole cameras first."
FULL_FROM = 0.75  # from this share of the full size on, the full size is used
BORDER = 4  # pixels by which the photo's edge is extended, for interpolation
SIDES, EXACT = (128, 64, 32, 16, 8, 4), 0.01  # pixels: sides of squares; their largest error
_again = threading.Lock()
CACHE_VERSION = 4  # part of each cached photo's name: increase it if the pixels change
# Measured bytes (docs/reliability.md) for a pixel of the photo's copy at `source`'s size: during
# resampling, in addition to decoding; and during undistortion.
PER_RESAMPLED, PER_SOURCE_PIXEL = 12, 13
PER_MASKED = 16  # for a pixel of the larger of file and copy, for weights, in addition


@dataclass(frozen=True, kw_only=True)
class UndistortionPlan:
    """The plan for one photo: decode to `source`'s size, undistort, resample to `target`.

    Attributes:
        photo, size: the file, and its (width, height).
        source, target: the distorted camera, and its pinhole.
        digest: hash of the file; known before the photo is undistorted.
        turn: see `PosedImage`; `size` is the size after it.
        colours: the treatment of its colour space (`photos.contents`).
        counted: makes its mask, which weights the resampling; None: it has none.
        mask: hash of everything that decides the mask.
    """

    photo: Path
    size: tuple[int, int]
    source: ModelCamera
    target: Camera
    digest: str = ""
    turn: int = AS_STORED
    colours: str = ""
    counted: Callable[[], NDArray[np.bool_]] | None = None
    mask: str = ""

    def key(self) -> str:
        """Hash of everything that decides the undistorted photo's pixels."""
        size = (self.target.width, self.target.height)
        turn = () if self.turn == AS_STORED else (self.turn,)
        text = (
            repr((CACHE_VERSION, self.digest, self.source, size, *turn)) + self.colours + self.mask
        )
        return hashlib.sha256(text.encode("ascii")).hexdigest()[:32]

    def memory(self) -> int:
        """The most bytes that `undistort` takes."""
        file, source = self.size[0] * self.size[1], self.source.width * self.source.height
        resampling = 0 if source == file else PER_RESAMPLED * source
        masked = PER_MASKED * max(file, source) if self.counted else 0
        decoding = decoding_bytes(self.photo, self.size) + resampling
        return max(decoding, PER_SOURCE_PIXEL * source) + masked

    def fitting_side(self, memory: int) -> int:
        """The longest side of a target that fits into this memory; 0 if there is none."""
        file = self.size[0] * self.size[1]
        left = memory - decoding_bytes(self.photo, self.size)
        source = min(left / PER_RESAMPLED, memory / PER_SOURCE_PIXEL)
        if source < 1:
            return 0
        share = min((source / file) ** 0.5, 0.9 * FULL_FROM)
        pinhole = undistorted_camera(resized_lens(self.source, *self.size))
        return max(1, int(0.99 * max(pinhole.width, pinhole.height) * share / OVERSAMPLING))


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


def plan_undistortion(
    photo: Path,
    camera: ModelCamera,
    size: tuple[int, int],
    shrink: Callable[[int, int], tuple[int, int]],
    turn: int = AS_STORED,
) -> UndistortionPlan:
    """Plan the undistortion of a photo; SceneError if the camera cannot be undistorted.

    Args:
        photo: the file.
        camera: the photo's camera in the model; the photo may be a resampled copy.
        size: (width, height) of the photo on disk, after `turn`.
        shrink: (width, height) of the undistorted photo -> requested (width, height).
    """
    source = resized_lens(camera, *size)
    pinhole = undistorted_camera(source)
    target = pinhole.resized(*shrink(pinhole.width, pinhole.height))
    share = OVERSAMPLING * max(target.width / pinhole.width, target.height / pinhole.height)
    if share < FULL_FROM:
        source = resized_lens(camera, round(size[0] * share), round(size[1] * share))
        # The smaller photo's pinhole differs by less than a pixel. The target must match it.
        target = undistorted_camera(source).resized(target.width, target.height)
    return UndistortionPlan(photo=photo, size=size, source=source, target=target, turn=turn)


def undistort_again(plan: UndistortionPlan, path: Path) -> None:
    """Replace a damaged or lost photo in the cache; raises as `undistort`."""
    with _again:  # two threads may find the damage at the same time
        undistort(plan, path)


def undistort(plan: UndistortionPlan, path: Path) -> None:
    """Undistort the photo to a PNG; PhotoError if it cannot be decoded."""
    result = undistorted_photo(plan)
    with atomic_write(path) as file:
        result.save(file, format="PNG", compress_level=1)


def undistorted_photo(plan: UndistortionPlan) -> Any:
    """Undistort the photo; returns a Pillow image.

    PhotoError: it cannot be decoded, or its file does not have the plan's digest.
    """
    from PIL import Image  # only for pixels: cameras do not need it

    from ..photos.decode import decode, weighted
    from ..photos.mask_images import resized

    source = plan.source.width, plan.source.height
    pixels = decode(plan.photo, source, plan.turn, plan.counted)
    check_unchanged(plan.photo, plan.digest)  # the file is named after the digest
    size = (plan.target.width, plan.target.height)

    def flat(values: NDArray[Any]) -> Image.Image:
        result = Image.fromarray(undistorted_pixels(values, plan.source))
        return result if result.size == size else result.resize(size, Image.Resampling.LANCZOS)

    if plan.counted is None:
        return flat(pixels)
    mask = resized(plan.counted(), source)
    return Image.fromarray(weighted(pixels, mask, lambda picture: flat(np.asarray(picture))))


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
"""left, top, right, bottom in the pinhole's picture; the same corners in the padded photo: x, y of
the upper left, lower left, lower right and upper right one."""


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


def temporary_folder() -> Path:
    """Create a folder that is deleted at the end of this process."""
    folder, owner = new_scratch("roigs-photos-")
    atexit.register(remove_scratch, folder, owner)
    return folder


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


STAGE = "undistort"
PER_PIXEL = 3  # bytes of a PNG, at most; photos take about 2


def undistort_all(
    plans: Iterable[UndistortionPlan], cache: Path | None, context: Context = QUIET
) -> dict[str, Path]:
    """Undistort the photos: plan's key -> file; damaged photos are skipped.

    `cache`: they are kept in its folder `undistorted`; None: in a temporary folder.

    Raises:
        SceneError: the machine has too little memory for one of them.
        RunFolderError: the cache cannot be written.
    """
    folder = temporary_folder() if cache is None else own_folder(cache, UNDISTORTED)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    by_key = {plan.key(): plan for plan in plans}
    paths = {key: folder / f"{key}.png" for key in by_key}
    missing = [plan for key, plan in by_key.items() if not paths[key].is_file()]
    if not missing:
        return paths
    memory = _memory(missing, context)
    space = disk_message(
        PER_PIXEL * sum(plan.target.width * plan.target.height for plan in missing), folder
    )
    if space.level == "warning":
        context.emit(space)

    def make(plan: UndistortionPlan) -> None:
        undistort(plan, paths[plan.key()])

    with in_parallel(make, missing, memory, context, STAGE) as work:
        for plan, job in work:
            try:
                job.result()
            except PhotoError as error:
                context.warn(error.message)
                del paths[plan.key()]
    release_freed_memory()
    return paths


def missing_in(cache: Path, images: Iterable[PosedImage]) -> list[PosedImage]:
    """The photos that are not undistorted yet; `cache` may be empty or missing."""
    return [
        image
        for image in images
        if image.distorted and not (cache / UNDISTORTED / f"{image.digest}.png").is_file()
    ]


def remove_unused(cache: Path, images: Iterable[PosedImage]) -> None:
    """Delete the undistorted photos in `cache` that `images` do not use; other files stay."""
    used = {image.path.name for image in images}
    for path in own_folder(cache, UNDISTORTED).glob("[0-9a-f]" * 32 + ".png"):
        if path.name not in used:
            with suppress(OSError):
                path.unlink()


def _memory(plans: Sequence[UndistortionPlan], context: Context) -> int:
    """The bytes that the largest photo needs; reports the memory of all threads."""
    largest = max(plans, key=UndistortionPlan.memory)
    needed, machine = largest.memory(), machine_memory()
    if needed + ENGINE > machine:
        pixels = largest.size[0] * largest.size[1]
        side = largest.fitting_side(machine - ENGINE)
        raise SceneError(
            f"Undistorting a photo of {pixels / 1e6:.1f} megapixels needs"
            f" {in_gb(needed + ENGINE)} of memory; this machine has {in_gb(machine)}.",
            f"Use --max-side {side} or less." if side else "Use smaller photos (--images).",
        )
    threads = min(threads_for(needed), len(plans))
    context.info(
        f"Memory: up to about {in_gb(threads * needed + ENGINE)} of {in_gb(machine)} while photos"
        f" are undistorted, {threads} at a time."
    )
    return needed
