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
from ..photos.masks import write_mask
from ..photos.parallel import decoding_bytes, in_parallel, threads_for
from .checks import named
from .folder import Folder
from .look import Photo

RECORD = "masks.json"


def make_masks(
    photos: Sequence[Photo], source: Path, options: MaskOptions, folder: Folder, context: Context
) -> dict[str, MaskPlan]:
    """Write the masks that the folder does not have yet, and say how many there are.

    Args:
        photos: those to reconstruct.
        source: their folder.
        options: which masks are wanted.
        folder: of the reconstruction.
        context: gets the messages; checked for cancellation between photos.

    Returns:
        How each mask is made, by the photo's name; a photo with an opaque alpha channel has none.

    Raises:
        MaskError, PhotoError: a mask cannot be used.
        RunFolderError: the folder cannot be written.
        Stopped: on request.
    """
    plans = _plans(photos, source, options, context)
    if not plans:
        return {}
    known, digests = _record(folder), {name: plan.digest() for name, plan in plans.items()}
    missing = [
        name
        for name in plans
        if known.get(name) != digests[name] or not _place(folder, name).is_file()
    ]
    largest = max(decoding_bytes(plan.photo, plan.size) for plan in plans.values())

    def make(name: str) -> bool | None:
        """Write a mask; whether anything of the photo is used. None: an opaque alpha channel."""
        mask = plans[name].make()
        if plans[name].source.file is None and mask.all():
            return None
        write_mask(_place(folder, name), mask)
        return bool(mask.any())

    with closing(in_parallel(make, missing, threads_for(largest), context)) as work:
        used = {name: job.result() for name, job in work}
    masks = {name: plan for name, plan in plans.items() if used.get(name, True) is not None}
    if masks:
        write_json(folder.work(RECORD), {name: digests[name] for name in masks})
        text = f"{counted(len(masks), 'photo')} with a mask: no features where it is black."
        context.info(text)
    hidden = [name for name in used if used[name] is False]
    if hidden:
        context.warn(f"{counted(len(hidden), 'photo')} {HIDDEN}: {named(hidden)}.")
    return masks


def digest_of(masks: Mapping[str, MaskPlan]) -> str:
    """Hash of all masks; empty: there are none."""
    return json_digest({name: plan.digest() for name, plan in masks.items()}) if masks else ""


def _plans(
    photos: Sequence[Photo], source: Path, options: MaskOptions, context: Context
) -> dict[str, MaskPlan]:
    """As `make_masks`, before anything is decoded, so of opaque alpha channels as well."""
    if not options.used:
        return {}
    files = MaskFiles(source, options.folder)
    found = {}
    for photo in photos:
        context.check_cancelled()
        place = find_mask(photo.name, photo.path, files, options)
        if place is None:
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


def _place(folder: Folder, name: str) -> Path:
    return folder.masks / f"{name}.png"


def _record(folder: Folder) -> dict[str, Any]:
    """Name -> digest, of the masks that were written."""
    record: Any = {}
    with suppress(RunFolderError):
        record = read_json(folder.work(RECORD))
    return record if isinstance(record, dict) else {}
