"""Reads the masks of a scene's photos; undistorts and resamples them for its cameras; caches them.

Masks of photos mark the used pixels. Masks of boxes show their objects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..context import QUIET, Context
from ..formats.files import own_folder
from ..formats.names import same_name
from ..formats.run_files import MASKS
from ..formats.text import counted, named
from ..model.roi import AREA_SIDE
from ..model.scene import PhotoMask, PosedImage
from ..photos.headers import content_digest, photo_size
from ..photos.mask_paths import MaskFiles, MaskOptions
from ..photos.parallel import decoding_bytes, in_parallel
from ..photos.rotation import AS_STORED, turned, turned_size
from .lenses import undistorted_mask
from .undistort import UndistortionPlan, temporary_folder

if TYPE_CHECKING:
    from ..photos.mask_images import Mask

STAGE = "masks"
VERSION, OBJECT_VERSION = 2, 1  # part of masks' digests: increase them if masks change
HIDDEN = "hidden by its mask"
Key = TypeVar("Key")


@dataclass(frozen=True, kw_only=True)
class MaskPlan:
    """The plan for making the mask of one photo.

    Attributes:
        photo, size: its file, and that file's (width, height) after `turn`.
        file: of the mask; None: the photo's alpha channel.
        content: hash of the file that contains the mask.
        target: (width, height) of the mask.
        inverted: see `MaskOptions`.
        undistortion: of the photo; None: it has no distortion.
        turn: see `PosedImage`.
        of_object: whether it shows an object; False: it marks the used pixels.
    """

    photo: Path
    size: tuple[int, int]
    file: Path | None
    content: str
    target: tuple[int, int]
    inverted: bool = False
    undistortion: UndistortionPlan | None = None
    turn: int = AS_STORED
    of_object: bool = False

    def digest(self) -> str:
        """Hash of everything that decides the mask."""
        lens = self.undistortion and self.undistortion.source
        kind = "alpha" if self.file is None else "inverted" if self.inverted else "file"
        kind += " of an object" if self.of_object else ""
        kind += "" if self.turn == AS_STORED else f" turned {self.turn}"
        version = OBJECT_VERSION if self.of_object else VERSION
        text = repr((version, kind, self.content, lens, self.target))
        return hashlib.sha256(text.encode("ascii")).hexdigest()[:32]

    def whole(self) -> Mask:
        """The mask at the photo's `size`; raises as `make`."""
        from ..photos.mask_images import resized

        return resized(self._given(), self.size)

    def hint(self) -> str:
        """Advice if the file cannot be read."""
        from ..photos.mask_images import HINT, OBJECT_HINT

        return OBJECT_HINT if self.of_object else HINT

    def _given(self) -> Mask:
        """The mask in its file, turned; raises as `read_mask` and `alpha_mask`."""
        from ..photos import mask_images as masks

        if self.file is None:
            return turned(masks.alpha_mask(self.photo), self.turn)
        return masks.read_mask(
            self.file, self.size, inverted=self.inverted, hint=self.hint(), turn=self.turn
        )

    def make(self) -> Mask:
        """The mask for the photo's camera; raises as `read_mask` and `alpha_mask`."""
        from ..photos import mask_images as masks

        least, mask = masks.HALF if self.of_object else masks.ALL, self._given()
        if self.undistortion is not None:
            lens = self.undistortion.source
            mask = masks.resized(mask, (lens.width, lens.height), least)
            mask = undistorted_mask(mask, lens, least)
        return masks.resized(mask, self.target, least)

    def kept(self, path: Path, *, write: bool) -> Mask:
        """Read the mask at `path`, or make it now and, if `write`, write it there."""
        from ..photos.mask_images import MaskError, stored_mask, write_mask

        with suppress(OSError, MaskError):
            mask = stored_mask(path)
            if mask.shape == self.target[::-1]:
                return mask
        mask = self.make()
        if write:
            write_mask(path, mask)
        return mask


def _plan(
    photo: Path, digest: str, file: Path | None, turn: int, *, inverted: bool, of_object: bool
) -> MaskPlan:
    """Plan a photo's mask at the size of its file; MaskError if `file` cannot be read.

    `photo`, `digest`: the photo's file, and its hash. See `MaskPlan` for the others.
    """
    size = turned_size(photo_size(photo), turn)
    plan = MaskPlan(
        photo=photo,
        size=size,
        file=file,
        content=digest,
        target=size,
        inverted=inverted,
        turn=turn,
        of_object=of_object,
    )
    if file is None:
        return plan
    try:
        return replace(plan, content=content_digest(file))
    except OSError as error:
        from ..photos.mask_images import MaskError

        text = f"Cannot read the mask {file} ({error.strerror})."
        raise MaskError(text, plan.hint()) from error


def find_mask(
    name: str,
    photo: Path,
    digest: str,
    files: MaskFiles,
    options: MaskOptions,
    *,
    turn: int = AS_STORED,
) -> MaskPlan | None:
    """Plan a photo's mask, from a file or its alpha channel; None if it has none.

    `photo`, `digest`: the photo's file, and its hash. MaskError: the mask cannot be read.
    """
    from ..photos.mask_images import has_alpha

    file = files.find(name)
    if file is None and not has_alpha(photo):
        return None
    inverted = options.inverted and file is not None and not files.is_made(file)
    return _plan(photo, digest, file, turn, inverted=inverted, of_object=False)


def plan_object_masks(
    images: Mapping[int, PosedImage], files: MaskFiles, options: MaskOptions
) -> dict[tuple[int, str], MaskPlan]:
    """Plan the masks of the boxes' objects: (photo's key, box) -> plan.

    A folder of photos may have the name of a box. Files that are the photos' own masks are skipped.
    Raises as `find_mask`.
    """
    found = {
        (key, box): file
        for box in options.boxes
        for find in [files.of_object(box, options.objects)]
        for key, image in images.items()
        if (file := find(image.name)) is not None
    }
    used = options.used and bool(found)  # only if needed: the next search is slow
    taken = {files.find(image.name) for image in images.values()} if used else set()
    inverted = options.objects_inverted
    return {
        (key, box): _plan(i.path, i.file_digest, file, i.turn, inverted=inverted, of_object=True)
        for (key, box), file in found.items()
        for i in [images[key]]
        if file not in taken
    }


def make_masks(
    plans: Mapping[Key, MaskPlan], cache: Path | None, context: Context = QUIET, *, write: bool
) -> dict[Key, tuple[PhotoMask, float]]:
    """Make the masks: key -> mask, and its share of pixels (exactly 0 if empty, 1 if full).

    Args:
        cache: the masks are kept in its folder `masks`; None: in a temporary folder.
        write: False: nothing is written, and the masks' files may be missing.

    Raises:
        MaskError, PhotoError: a mask cannot be used.
        RunFolderError: the cache cannot be written.
    """
    if not plans:
        return {}
    from PIL import Image

    folder = temporary_folder() if cache is None else own_folder(cache, MASKS)
    memory = max(decoding_bytes(plan.photo, plan.size) for plan in plans.values())

    def made(key: Key) -> tuple[PhotoMask, float]:
        plan = plans[key]
        path = folder / f"{plan.digest()}.png"
        mask = plan.kept(path, write=write)
        remake = partial(plan.kept, path, write=True)
        scale = min(1.0, AREA_SIDE / max(mask.shape))
        height, width = (max(1, round(side * scale)) for side in mask.shape)
        small = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0)))
        photo_mask = PhotoMask(
            digest=plan.digest(),
            path=path,
            remake=remake,
            small=np.asarray(small.resize((width, height), Image.Resampling.BOX)),
            whole=remake if plan.undistortion else plan.whole,
        )
        return photo_mask, float(mask.mean())

    with in_parallel(made, [*plans], memory, context, STAGE if write else "") as work:
        return {key: job.result() for key, job in work}


def mention_masks(used: int, files: MaskFiles, names: list[str], context: Context) -> None:
    """Report the number of used masks; warn of files that are no mask of any of these photos."""
    if used:
        context.info(f"{counted(used, 'photo')} with a mask: ignored pixels are not used.")
    unknown = files.unknown(names)
    if unknown:
        context.warn(
            f"{counted(len(unknown), 'file')} in {files.folder} or among the photos"
            f" {'is' if len(unknown) == 1 else 'are'} the mask of no photo:"
            f" {named(unknown)}. The mask of 012.jpg is 012.jpg.png."
        )


def mention_folders(
    files: MaskFiles, boxes: Sequence[str], names: list[str], context: Context
) -> None:
    """Warn of folders of masks that belong to no box; suggest the box with a similar name."""
    spelled = {same_name(box): box for box in boxes}
    for folder in files.of_no_box(boxes, names):
        close = get_close_matches(same_name(folder), spelled, 1)
        meant = f" Is '{spelled[close[0]]}' meant?" if close else ""
        context.warn(
            f"The masks in {files.folder / folder} are not used: no box has that name.{meant}"
        )
