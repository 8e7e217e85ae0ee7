"""The masks of photos that are reconstructed, kept as pycolmap reads them: one file per photo.

Where masks are, and what they may be, is decided as in training (`photos.mask_files`,
`photos.masks`). pycolmap needs them in one folder, `NAME.png` for the photo NAME, at its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from ..colmap.photo_masks import HIDDEN, MaskPlan, find_mask, mask_digest
from ..context import Context
from ..errors import RunFolderError
from ..formats.files import read_json, write_json
from ..formats.text import counted, json_digest
from ..photos.mask_files import MaskFiles, MaskOptions
from ..photos.masks import alpha_mask, write_mask
from ..photos.parallel import decoding_bytes, in_parallel, threads_for
from .checks import named
from .folder import Folder
from .look import Photo

RECORD = "masks.json"


def masks_of(
    photos: Sequence[Photo], source: Path, options: MaskOptions, context: Context
) -> dict[str, MaskPlan]:
    """How to make the masks of the photos that have one, by name.

    Args:
        photos: those to reconstruct.
        source: their folder.
        options: which masks are wanted.
        context: checked for cancellation between photos.

    Raises:
        MaskError: a mask file cannot be read.
        PhotoError: a photo with an alpha channel cannot be read.
        Stopped: on request.
    """
    if not options.used:
        return {}
    files = MaskFiles(source, options.folder)
    found = {}
    for photo in photos:
        context.check_cancelled()
        place = find_mask(photo.name, photo.path, files, options)
        if place is None or (place.file is None and alpha_mask(photo.path).all()):
            continue
        found[photo.name] = MaskPlan(
            photo=photo.path,
            size=photo.size,
            source=place,
            content=photo.digest if place.file is None else mask_digest(place.file),
            undistortion=None,
            target=photo.size,
        )
    return found


def digest_of(masks: Mapping[str, MaskPlan]) -> str:
    """Hash of all masks; empty: there are none."""
    return json_digest({name: plan.digest() for name, plan in masks.items()}) if masks else ""


def write_masks(masks: Mapping[str, MaskPlan], folder: Folder, context: Context) -> None:
    """Write the masks that the folder does not have yet, and say how many there are.

    Raises:
        MaskError, PhotoError: a mask cannot be used.
        RunFolderError: the folder cannot be written.
        Stopped: on request.
    """
    if not masks:
        return
    known, made = _record(folder), {name: plan.digest() for name, plan in masks.items()}
    missing = [
        name
        for name in masks
        if known.get(name) != made[name] or not _place(folder, name).is_file()
    ]
    largest = max(decoding_bytes(plan.photo, plan.size) for plan in masks.values())

    def write(name: str) -> bool:
        """Write a mask; whether anything of the photo is used."""
        mask = masks[name].make()
        write_mask(_place(folder, name), mask)
        return bool(mask.any())

    with closing(in_parallel(write, missing, threads_for(largest), context)) as work:
        hidden = [name for name, job in work if not job.result()]
    write_json(folder.work(RECORD), made)
    context.info(f"{counted(len(masks), 'photo')} with a mask: no features where it is black.")
    if hidden:
        context.warn(f"{counted(len(hidden), 'photo')} {HIDDEN}: {named(hidden)}.")


def _place(folder: Folder, name: str) -> Path:
    return folder.masks / f"{name}.png"


def _record(folder: Folder) -> dict[str, Any]:
    """Name -> digest, of the masks that were written."""
    record: Any = {}
    with suppress(RunFolderError):
        record = read_json(folder.work(RECORD))
    return record if isinstance(record, dict) else {}
