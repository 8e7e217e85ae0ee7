"""Writes the masks of the photos to reconstruct for pycolmap: one file per photo.

Places and formats of masks are the same as in training (`photos.mask_paths`, `photos.mask_images`).
pycolmap needs them in one folder, `NAME.png` for the photo NAME, at its size.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from ..colmap.camera_masks import HIDDEN, MaskPlan, find_mask
from ..context import Context
from ..formats.files import cannot_write, own_file, read_record, sha256, write_json
from ..formats.names import inner_path
from ..formats.text import counted, named
from ..photos.headers import PhotoError, photo_size
from ..photos.mask_images import write_mask
from ..photos.mask_paths import MaskFiles, MaskOptions
from ..photos.parallel import decoding_bytes, in_parallel
from .folder import Folder
from .photo_checks import Photo

RECORD = "masks.json"


@dataclass(frozen=True, kw_only=True)
class Kept:
    """The record of a mask in the folder."""

    digest: str  # hash of all inputs
    sha256: str  # hash of the file, as the engine wrote it
    photos: str  # folder of the photos; relative if it is in the project


def write_masks(
    photos: Sequence[Photo], source: Path, options: MaskOptions, folder: Folder, context: Context
) -> dict[str, str]:
    """Write the masks that the folder does not have yet, and report their number.

    Masks that are no longer used are removed, unless the user changed them. `source` is the photos'
    folder.

    Returns:
        Hash of each mask, by the photo's name; a photo with an opaque alpha channel has none.

    Raises:
        MaskError, PhotoError: a mask cannot be used.
        RunFolderError: the folder cannot be written.
    """
    known: dict[str, Kept] = {}
    for name, entry in read_record(folder.work(RECORD)).items():
        with suppress(TypeError):
            known[name] = Kept(**entry)
    plans = _plans(photos, source, options, context)
    path, root = Path(os.path.realpath(source)), Path(os.path.realpath(folder.root))
    place = (path.relative_to(root) if path.is_relative_to(root) else path).as_posix()
    digests = {name: plan.digest() for name, plan in plans.items()}
    missing = [
        name
        for name in plans
        if name not in known
        or known[name].digest != digests[name]
        or not _place(folder, name).is_file()
    ]

    def make(name: str) -> bool | None:
        """Write a mask; returns whether any pixel is used. None: an opaque alpha channel."""
        mask = plans[name].make()
        if plans[name].file is None and mask.all():
            return None
        write_mask(_place(folder, name), mask)
        return bool(mask.any())

    if stale := known.keys() & set(missing):  # forget files before they change, in case of a kill
        kept = {name: asdict(known[name]) for name in sorted(known.keys() - stale)}
        write_json(folder.work(RECORD), kept)
    sizes = (decoding_bytes(plan.photo, plan.size) for plan in plans.values())
    with in_parallel(make, missing, max(sizes, default=1), context) as work:
        used = {name: job.result() for name, job in work}
    masks = {} if not options.used else _of_other_photos(photos, plans, known, place, folder)
    for name in plans:
        if used.get(name, True) is not None:
            sha = sha256(_place(folder, name)) if name in used else known[name].sha256
            masks[name] = Kept(digest=digests[name], sha256=sha, photos=place)
    _forget(known.keys() - masks.keys(), known, folder)
    if masks or known:
        write_json(folder.work(RECORD), {name: asdict(masks[name]) for name in sorted(masks)})
    if masks:
        text = f"{counted(len(masks), 'photo')} with a mask: no features where it is black."
        context.info(text)
    hidden = [name for name in used if used[name] is False]
    if hidden:
        context.warn(f"{counted(len(hidden), 'photo')} {HIDDEN}: {named(hidden)}.")
    return {name: kept.digest for name, kept in masks.items()}


def _plans(
    photos: Sequence[Photo], source: Path, options: MaskOptions, context: Context
) -> dict[str, MaskPlan]:
    """Plan the masks; nothing is decoded, so opaque alpha channels are included."""
    files = MaskFiles(source, options.folder, made=False)  # the folder's masks are copies
    plans = {}
    for photo in photos if options.used else ():
        context.check_cancelled()
        plan = find_mask(photo.name, photo.path, photo.digest, files, options)
        if plan is not None:
            plans[photo.name] = plan
    return plans


def _place(folder: Folder, name: str) -> Path:
    return own_file(folder.masks, f"{name}.png")


def _of_other_photos(
    photos: Sequence[Photo],
    plans: Mapping[str, MaskPlan],
    known: Mapping[str, Kept],
    place: str,
    folder: Folder,
) -> dict[str, Kept]:
    """The masks in the folder that were made for photos of the same names in another folder.

    A missing mask of photos in this folder was removed by the user.
    """
    return {
        photo.name: known[photo.name]
        for photo in photos
        if photo.name in known
        and photo.name not in plans
        and known[photo.name].photos != place
        and _size(_place(folder, photo.name)) == photo.size
    }


def _size(mask: Path) -> tuple[int, int] | None:
    with suppress(PhotoError):
        return photo_size(mask)
    return None


def _forget(names: Iterable[str], known: Mapping[str, Kept], folder: Folder) -> None:
    """Remove unchanged masks from the folder; RunFolderError if that fails."""
    for name in names:
        if inner_path(name) is None:
            continue
        path = _place(folder, name)
        try:
            if path.is_file() and sha256(path) == known[name].sha256:
                path.unlink()
        except OSError as error:
            raise cannot_write(path, error) from error
