"""Contents of photo files: hash, completeness, colours, exposure.

A small file stores them, with the size and times of the photo's file. So a photo is read again only
if its file has changed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.files import read_record, write_json
from ..formats.text import counted, json_digest, named
from .headers import CONVERTED, DAMAGED, PhotoError, content_digest, photo_size
from .parallel import decoding_bytes, in_parallel

FILE, KEYS = "photos.json", ("version", "photos")
VERSION = 4  # increase it if the contents found for the same photo change
STAGE = "photos"
CHECKSUM = "checksum"  # key of the file
WRITE_SECONDS = 60.0


@dataclass(frozen=True, kw_only=True)
class Content:
    """The content of a photo's file."""

    size: int  # bytes of the file
    modified: int  # this and the next: the file's two times, ns
    changed: int
    digest: str = ""  # hash of its bytes, 32 hexadecimal digits; empty: unreadable
    whole: bool | None = None  # whether the photo can be decoded and is complete; None: not known
    colours: str = ""  # the treatment of its colour space, see `colours`; empty: it is sRGB
    exposure: float | None = None  # in stops, as `exif_exposure`
    tone: str = ""  # "black" or "white": a photo of more than 8 bits a channel is nearly that


UNREAD = Content(size=-1, modified=0, changed=0, whole=False)
"""The content of a file that could not be read this time. No file has this stamp, so the file is
read again."""


def read_contents(
    photos: Mapping[str, Path],
    memory: Path | None = None,
    context: Context = QUIET,
    *,
    check: bool = True,
) -> dict[str, Content]:
    """Name -> content of photos (name -> file); reads only files that are new or have changed.

    With `check`, photos are decoded, too, and progress is reported. Otherwise `whole` may stay
    unknown, and nothing is stored. After a stop, the contents found so far are stored.

    `memory`: file that stores contents; a missing or damaged one counts as empty.
    """
    known = _remembered(memory) if memory else {}
    found = {n: known[n] for n, path in photos.items() if _is_current(known.get(n), path, check)}
    missing = [name for name in photos if name not in found]
    last, stage = time.monotonic(), STAGE if check else ""
    largest = max((_memory(photos[name]) for name in missing), default=0)

    def look(name: str) -> Content:
        return _read(photos[name], check, context)

    try:
        with in_parallel(look, missing, largest, context, stage) as work:
            for name, job in work:
                found[name] = job.result()
                if check and time.monotonic() - last > WRITE_SECONDS:
                    last = time.monotonic()
                    _remember(memory, found)
    finally:
        if missing and check:
            _remember(memory, found)
    if check:
        _tell(found, context)
    return found


def _is_current(known: Content | None, path: Path, check: bool) -> bool:
    """Whether the known content is sufficient, and the file is unchanged."""
    if known is not None and not (check and known.whole is None):
        with suppress(OSError):
            return _stamp(path) == Content(
                size=known.size, modified=known.modified, changed=known.changed
            )
    return False


def _remember(memory: Path | None, found: Mapping[str, Content]) -> None:
    """Store the contents. This only saves time, so a full disk is no reason to stop."""
    if memory is not None:
        with suppress(RunFolderError):
            files = {name: asdict(content) for name, content in sorted(found.items())}
            record = {"version": VERSION, "photos": files, CHECKSUM: json_digest(files)}
            write_json(memory, record, durable=False)


def _stamp(path: Path) -> Content:
    """A stamp that is equal while the file is unchanged; OSError if there is no file."""
    status = path.stat()
    return Content(size=status.st_size, modified=status.st_mtime_ns, changed=status.st_ctime_ns)


def _read(path: Path, check: bool, context: Context) -> Content:
    """Hash the file, and decode the photo if `check`."""
    from .colours import colours_in_words  # imports Pillow, which cameras do not need
    from .decode import check_whole
    from .exposures import exif_exposure

    context.check_cancelled()
    try:
        stamp = _stamp(path)
        digest = content_digest(path)
    except OSError:
        return UNREAD
    content = replace(
        stamp, digest=digest, colours=colours_in_words(path), exposure=exif_exposure(path)
    )
    if not check:
        return content
    try:
        tone = check_whole(path)
    except PhotoError as error:
        # After one failure of the disk, do not store that the photo is damaged.
        passing = getattr(error.__cause__, "errno", None) is not None
        return UNREAD if passing else replace(content, whole=False)
    return replace(content, whole=True, tone=tone)


def _tell(found: Mapping[str, Content], context: Context) -> None:
    """Report photos that are not in sRGB, or whose values do not fill their type."""

    def names(what: str, value: str) -> list[str]:
        return sorted(n for n, c in found.items() if c.whole and getattr(c, what) == value)

    if converted := names("colours", CONVERTED):
        context.info(
            f"{counted(len(converted), 'photo')} in another colour space than sRGB:"
            " converted; colours outside sRGB are clipped."
        )
    if damaged := names("colours", DAMAGED):
        context.warn(
            f"{counted(len(damaged), 'photo')} with a colour profile that cannot be used,"
            f" read as sRGB: {named(damaged)}. Save the profile again, or remove it."
        )
    for tone in sorted({content.tone for content in found.values()} - {""}):
        toned = names("tone", tone)
        context.warn(
            f"{counted(len(toned), 'photo')} of more than 8 bits a channel read as nearly {tone}:"
            f" {named(toned)}. Scale the values to the whole range of the file's type (floats:"
            " 0 to 1), or save 8 bits a channel."
        )


def _memory(path: Path) -> int:
    try:
        return decoding_bytes(path, photo_size(path))
    except PhotoError:
        return 0


def _remembered(path: Path) -> dict[str, Content]:
    record = read_record(path)
    photos: Any = record.get("photos")
    if record.get("version") != VERSION or record.get(CHECKSUM) != json_digest(photos):
        return {}
    try:
        return {name: Content(**content) for name, content in photos.items()}
    except (TypeError, AttributeError):  # edited by hand, with a valid checksum
        return {}
