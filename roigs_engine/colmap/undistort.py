"""Undistorts photos to pinhole cameras, in parallel, into a cache."""

from __future__ import annotations

import atexit
import hashlib
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.files import atomic_write, cannot_write, own_folder
from ..formats.run_files import UNDISTORTED
from ..formats.scratch import new_scratch, remove_scratch
from ..formats.text import in_gb
from ..machine import ENGINE, disk_message, machine_memory, release_freed_memory
from ..model.scene import Camera, PosedImage
from ..photos.headers import PhotoError, check_unchanged
from ..photos.parallel import decoding_bytes, in_parallel, threads_for
from ..photos.rotation import AS_STORED
from .lenses import resized_lens, undistorted_camera, undistorted_pixels
from .records import ModelCamera

# Photos are undistorted at full size, or at this multiple of a much smaller target size.
OVERSAMPLING = 2.0
FULL_FROM = 0.75  # from this share of the full size on, the full size is used
_again = threading.Lock()
CACHE_VERSION = 4  # part of each cached photo's name: increase it if the pixels change
# Measured bytes (docs/reliability.md) for each pixel of the photo's copy at `source`'s size: during
# resampling, in addition to decoding; during undistortion.
PER_RESAMPLED, PER_SOURCE_PIXEL = 12, 13
PER_MASKED = 16  # for weights, in addition, for each pixel of the larger of file and copy


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
    with _again:  # two threads may detect the damage at the same time
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


def temporary_folder() -> Path:
    """Create a folder that is deleted at the end of this process."""
    folder, owner = new_scratch("roigs-photos-")
    atexit.register(remove_scratch, folder, owner)
    return folder


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
