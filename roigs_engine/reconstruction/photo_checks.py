"""Inspects photos before matching: size, camera, sharpness, copies; warnings."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..context import Context
from ..errors import SceneError
from ..formats.text import counted, named
from ..photos.contents import read_contents
from ..photos.decode import decode
from ..photos.headers import exif_of, open_photo, photo_size
from ..photos.parallel import decoding_bytes, in_parallel

STAGE = "look at photos"
LOOK_SIDE = 1024  # px of the longest side, to measure sharpness
EXIF_IFD = 0x8769
# EXIF tags: maker, model; in another table, focal length, equivalent on 35 mm film, lens.
DEVICE_TAGS, LENS_TAGS = (0x010F, 0x0110), (0x920A, 0xA405, 0xA434)


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A usable photo."""

    name: str  # path below the folder, with `/`
    path: Path  # the file
    digest: str  # hash of the bytes
    size: tuple[int, int]  # width and height, px, as in the file: orientation tags are ignored
    device: str  # maker, model, focal lengths and lens, to identify cameras; "": unknown
    sharpness: float  # fine detail as a share of the contrast; comparable within a set of photos


@dataclass(frozen=True, kw_only=True)
class Found:
    """The photos of a folder: usable ones, and the names of others by reason."""

    photos: tuple[Photo, ...]
    unreadable: tuple[str, ...]
    copies: Mapping[str, str]
    """Name -> name of an identical photo that is used instead."""
    unread: Mapping[str, int] = field(default_factory=dict)
    """Extension such as `.NEF` -> number of photos of this format; they were not read."""
    masks: Mapping[str, str] = field(default_factory=dict)
    """Name -> hash of the photo's mask; no features are found where the mask is black."""


def look_at(files: Mapping[str, Path], remembered: Path, context: Context) -> Found:
    """Inspect photos (name -> file); SceneError if fewer than two can be used.

    `remembered`: file that stores their contents (`photos.contents`).
    """
    contents = read_contents(files, remembered, context)
    whole = [name for name in sorted(files) if contents[name].whole]
    first: dict[str, str] = {}
    copies = {}
    for name in whole:
        digest = contents[name].digest
        if first.setdefault(digest, name) != name:
            copies[name] = first[digest]
    kept = [name for name in whole if name not in copies]
    unreadable = tuple(sorted(set(files) - set(whole)))
    if len(kept) < 2:
        raise SceneError(
            f"A reconstruction needs at least two different photos; {len(kept)} can be used"
            f" ({len(unreadable)} unreadable, {len(copies)} copies).",
            "Add photos of the same place from other sides.",
        )
    sizes = {}
    for name in kept:
        context.check_cancelled()
        sizes[name] = photo_size(files[name])
    memory = max(decoding_bytes(files[name], sizes[name]) for name in kept)

    def look(name: str) -> Photo:
        path, size = files[name], sizes[name]
        factor = min(1.0, LOOK_SIDE / max(size))
        small = max(1, round(size[0] * factor)), max(1, round(size[1] * factor))
        return Photo(
            name=name,
            path=path,
            digest=contents[name].digest,
            size=size,
            device=_device(path),
            sharpness=fine_detail(decode(path, small).mean(axis=2, dtype=np.float32)),
        )

    with in_parallel(look, kept, memory, context, STAGE) as work:
        photos = tuple(job.result() for _, job in work)
    return Found(photos=photos, unreadable=unreadable, copies=copies)


def camera_groups(photos: Sequence[Photo], cameras: str) -> list[list[Photo]]:
    """Group photos that share a camera (see `Reconstruct.cameras`) and have the same size."""
    groups: dict[object, list[Photo]] = defaultdict(list)
    for photo in photos:
        own = {"one": "", "each": photo.name, "auto": photo.device}[cameras]
        groups[photo.size, own].append(photo)
    return list(groups.values())


def _device(path: Path) -> str:
    with suppress(Exception):  # Pillow's readers raise nearly anything on damaged files
        with open_photo(path) as photo:
            tags = exif_of(photo)
            lens = tags.get_ifd(EXIF_IFD)
        known = [tags.get(tag) for tag in DEVICE_TAGS] + [lens.get(tag) for tag in LENS_TAGS]
        return "; ".join(str(value).strip("\0 ") for value in known if value is not None)
    return ""


def fine_detail(grey: NDArray[np.float32] | NDArray[np.uint8]) -> float:
    """The share of fine detail in the contrast of a picture (H, W); see `Photo.sharpness`."""
    grey = grey.astype(np.float32, copy=False)
    if min(grey.shape) < 3:
        return 0.0
    inner = grey[1:-1, 1:-1]
    second = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:] - 4 * inner
    return float(second.var() / max(float(grey.var()), 1.0))


SMALL = 480  # px of the longest side; smaller photos have few features
BLURRED = 0.2  # of the median sharpness; photos below this are blurred


def warnings_of(found: Found) -> list[str]:
    """One sentence for each kind of problem, usually none."""
    checks = [
        (list(found.unreadable), "cannot be read and {is} left out"),
        (list(found.copies), "{is} a copy of another and {is} left out"),
        (small(found.photos), f"{{is}} smaller than {SMALL} px and may not be registered"),
        (blurred(found.photos), "{is} less sharp than the others and may not be registered"),
    ]
    told = unread_in_words(found.unread)
    for names, text in checks:
        if names:
            what = text.format(**{"is": "is" if len(names) == 1 else "are"})
            told.append(f"{counted(len(names), 'photo')} {what}: {named(names)}.")
    return told


def unread_in_words(unread: Mapping[str, int]) -> list[str]:
    """The sentence on photos in unsupported formats, if there are any; see `Found.unread`."""
    kinds = [f"{number} {kind}" for kind, number in sorted(unread.items())]
    total = sum(unread.values())
    were = "file was" if total == 1 else "files were"
    what = "it" if total == 1 else "them"
    return [f"{', '.join(kinds)} {were} not read: export {what} as JPEG."] if kinds else []


def small(photos: Sequence[Photo]) -> list[str]:
    """Names of photos smaller than `SMALL`."""
    return [photo.name for photo in photos if max(photo.size) < SMALL]


def blurred(photos: Sequence[Photo]) -> list[str]:
    """Names of photos with much less fine detail than the median."""
    usual = float(np.median([photo.sharpness for photo in photos]))
    return [photo.name for photo in photos if photo.sharpness < BLURRED * usual]
