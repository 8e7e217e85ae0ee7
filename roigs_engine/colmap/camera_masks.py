"""Masks of a scene's photos as its cameras see them: read, undistorted, resampled, kept.

Those of the photos themselves say what counts, those of boxes show their objects.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..formats.files import own_folder
from ..formats.run_files import MASKS
from ..formats.text import counted, first_of
from ..model.roi import AREA_SIDE
from ..model.scene import PhotoMask, PosedImage
from ..photos.headers import content_digest, photo_size
from ..photos.mask_paths import MaskFiles, MaskOptions
from ..photos.parallel import decoding_bytes, in_parallel, threads_for
from .undistort import UndistortionPlan, temporary_folder, undistorted_pixels

if TYPE_CHECKING:
    from ..photos.mask_images import Mask

STAGE = "masks"
VERSION = 1  # part of each mask's digest: increase it if masks become others
HIDDEN = "hidden by its mask"
Key = TypeVar("Key")


@dataclass(frozen=True, kw_only=True)
class MaskSource:
    """Where the mask of a photo comes from.

    Attributes:
        file: None: the photo's alpha channel.
        inverted: see `MaskOptions`.
    """

    file: Path | None
    inverted: bool = False


@dataclass(frozen=True, kw_only=True)
class MaskPlan:
    """How the mask of one photo is made.

    Attributes:
        photo: its file.
        size: (width, height) of that file.
        source: of the mask.
        content: hash of the file that has the mask.
        undistortion: of the photo; None: it has no distortion.
        target: (width, height) of the mask.
        of_object: whether it shows an object; else it says what counts.
    """

    photo: Path
    size: tuple[int, int]
    source: MaskSource
    content: str
    undistortion: UndistortionPlan | None
    target: tuple[int, int]
    of_object: bool = False

    def digest(self) -> str:
        """Hash of all that decides the mask."""
        lens = self.undistortion and self.undistortion.source
        kind = "inverted" if self.source.inverted else "file"
        kind = "alpha" if self.source.file is None else kind
        kind += " of an object" if self.of_object else ""
        text = repr((VERSION, kind, self.content, lens, self.target))
        return hashlib.sha256(text.encode("ascii")).hexdigest()[:32]

    def make(self) -> Mask:
        """The mask for the photo's camera; raises as `read_mask` and `alpha_mask`."""
        from ..photos.mask_images import (
            ALL,
            HALF,
            HINT,
            OBJECT_HINT,
            alpha_mask,
            read_mask,
            resized,
        )

        least, hint = (HALF, OBJECT_HINT) if self.of_object else (ALL, HINT)

        if self.source.file is None:
            mask = alpha_mask(self.photo)
        else:
            inverted = self.source.inverted
            mask = read_mask(self.source.file, self.size, inverted=inverted, hint=hint)
        if self.undistortion is not None:
            lens = self.undistortion.source
            grey = np.where(resized(mask, (lens.width, lens.height), least), 255, 0)
            bitmap = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
            mask = undistorted_pixels(bitmap, lens, sharp=False)[..., 0] >= least
        return resized(mask, self.target, least)

    def kept(self, path: Path, *, write: bool) -> Mask:
        """The mask: from the file at `path`, or made now, and written there if `write`."""
        from ..photos.mask_images import MaskError, stored_mask, write_mask

        with suppress(OSError, MaskError):
            mask = stored_mask(path)
            if mask.shape == self.target[::-1]:
                return mask
        mask = self.make()
        if write:
            write_mask(path, mask)
        return mask


def find_mask(name: str, photo: Path, files: MaskFiles, options: MaskOptions) -> MaskSource | None:
    """Where the mask of a photo comes from: a file, or its alpha channel; None: it has none.

    Args:
        name: of the photo.
        photo: its file.
        files, options: where masks are, and which are wanted.
    """
    from ..photos.mask_images import has_alpha

    file = files.find(name)
    if file is not None:
        return MaskSource(file=file, inverted=options.inverted and not files.is_made(file))
    return MaskSource(file=None) if has_alpha(photo) else None


def plan_masks(
    images: Mapping[int, PosedImage],
    undistortions: Mapping[int, UndistortionPlan],
    files: MaskFiles,
    options: MaskOptions,
) -> dict[int, MaskPlan]:
    """How to make the masks of the photos that have one, by the photos' keys.

    Args:
        images: the photos, with their own files and digests, before they are undistorted.
        undistortions: of the photos with distortion.
        files, options: where masks are, and which are wanted.

    Raises:
        MaskError: a mask file cannot be read.
    """
    plans = {}
    for key, image in images.items():
        source = find_mask(image.name, image.path, files, options)
        if source is not None:
            plans[key] = _plan(image, source, undistortions.get(key))
    return plans


def plan_object_masks(
    images: Mapping[int, PosedImage],
    undistortions: Mapping[int, UndistortionPlan],
    files: MaskFiles,
    options: MaskOptions,
) -> dict[tuple[int, str], MaskPlan]:
    """How to make the masks of the boxes' objects, by the photos' keys and the boxes' names.

    A file that is also the mask of a photo, in a folder of that name, is none. Arguments and errors
    are those of `plan_masks`.
    """
    taken = {files.find(image.name) for image in images.values()} if options.used else set()
    inverted, plans = options.objects_inverted, {}
    for box in options.boxes:
        theirs = files.of_object(box, options.objects)
        for key, image in images.items():
            file = theirs.find(image.name)
            if file is not None and file not in taken:
                source = MaskSource(file=file, inverted=inverted)
                plan = _plan(image, source, undistortions.get(key), of_object=True)
                plans[key, box] = plan
    return plans


def _plan(
    image: PosedImage,
    source: MaskSource,
    undistortion: UndistortionPlan | None,
    *,
    of_object: bool = False,
) -> MaskPlan:
    """How to make a mask of a photo; MaskError if its file cannot be read."""
    return MaskPlan(
        photo=image.path,
        size=photo_size(image.path) or (image.camera.width, image.camera.height),
        source=source,
        content=image.file_digest if source.file is None else mask_digest(source.file, of_object),
        undistortion=undistortion,
        target=(image.camera.width, image.camera.height),
        of_object=of_object,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class MadeMask:
    """A mask, and whether it has no pixel, or all."""

    mask: PhotoMask
    empty: bool
    full: bool


def make_masks(
    plans: Mapping[Key, MaskPlan], cache: Path | None, context: Context = QUIET, *, write: bool
) -> dict[Key, MadeMask]:
    """The masks by the plans' keys.

    Args:
        plans: how to make them.
        cache: its folder `masks` keeps them; None: a temporary folder.
        context: gets the progress; checked for cancellation.
        write: False: nothing is written, and the masks' files may be missing.

    Raises:
        MaskError, PhotoError: a mask cannot be used.
        RunFolderError: the cache cannot be written.
        Stopped: on request.
    """
    if not plans:
        return {}
    folder = temporary_folder() if cache is None else own_folder(cache, MASKS)
    paths = {key: folder / f"{plan.digest()}.png" for key, plan in plans.items()}
    if write and not all(path.is_file() for path in paths.values()):
        context.emit(StageStarted(stage=STAGE, total=len(plans)))
    threads = threads_for(max(decoding_bytes(plan.photo, plan.size) for plan in plans.values()))
    made: dict[Key, MadeMask] = {}

    def look(key: Key) -> MadeMask:
        mask = plans[key].kept(paths[key], write=write)
        full, empty = bool(mask.all()), not mask.any()
        return MadeMask(mask=_photo_mask(plans[key], paths[key], mask), empty=empty, full=full)

    started = time.monotonic()
    with closing(in_parallel(look, [*plans], threads, context)) as work:
        for step, (key, job) in enumerate(work, start=1):
            made[key] = job.result()
            if write:
                context.progress(STAGE, step, len(plans), started)
    return made


def _photo_mask(plan: MaskPlan, path: Path, mask: Mask) -> PhotoMask:
    remake = partial(plan.kept, path, write=True)
    return PhotoMask(digest=plan.digest(), path=path, remake=remake, small=_small(mask))


def _small(mask: Mask) -> NDArray[np.uint8]:
    """The mask at about the size at which areas are measured (`PhotoMask.small`)."""
    from PIL import Image

    scale = min(1.0, AREA_SIDE / max(mask.shape))
    height, width = (max(1, round(side * scale)) for side in mask.shape)
    grey = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0)))
    return np.asarray(grey.resize((width, height), Image.Resampling.BOX))


def mention_masks(used: int, files: MaskFiles, names: list[str], context: Context) -> None:
    """Say how many photos have a mask, and warn of files that are the mask of no photo.

    Args:
        used: number of masks that are used.
        files: the mask files.
        names: of all photos of the model.
        context: gets the messages.
    """
    if used:
        context.info(f"{counted(used, 'photo')} with a mask: what it ignores is not used.")
    unknown = files.unknown(names)
    if unknown:
        context.warn(
            f"{counted(len(unknown), 'file')} in {files.folder} or among the photos"
            f" {'is' if len(unknown) == 1 else 'are'} the mask of no photo:"
            f" {first_of(unknown)}. The mask of 012.jpg is 012.jpg.png."
        )


def mask_digest(file: Path, of_object: bool = False) -> str:
    """Hash of a mask's file; MaskError if it cannot be read."""
    from ..photos.mask_images import HINT, OBJECT_HINT, MaskError

    try:
        return content_digest(file)
    except OSError as error:
        hint = OBJECT_HINT if of_object else HINT
        raise MaskError(f"Cannot read the mask {file} ({error.strerror}).", hint) from error
