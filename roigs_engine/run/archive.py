"""Results of a run made with other settings: moved to its folder `archive/`, restored on request.

Names there end in the first eight digits of a fingerprint. So the user can switch between settings
and nothing is deleted or trained twice.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path

from ..errors import RunFolderError
from ..formats.files import own_folder
from ..formats.run_files import ARCHIVE, ARCHIVED_RESULTS

DAMAGED = "damaged"


def archive(folder: Path, fingerprint: str) -> None:
    """Move a folder or file to `archive` beside it, if it exists.

    Raises:
        RunFolderError: it cannot be moved.
    """
    if folder.exists():
        move(folder, _free(archived(folder, fingerprint)))


def restore(folder: Path, fingerprint: str) -> None:
    """Move the archived `folder` of that fingerprint back, unless `folder` exists."""
    place = archived(folder, fingerprint)
    with suppress(OSError):  # an empty one, of an engine that was killed at its first file
        folder.rmdir()
    if place.exists() and not folder.exists():
        move(place, folder)


def archive_damaged(folder: Path, names: Iterable[str]) -> Path:
    """Move the damaged files `names` of `folder` to the archive; returns where they are.

    `folder` is removed if it is empty then.

    Raises:
        RunFolderError: one cannot be moved.
    """
    place = _free(archived(folder, DAMAGED))
    for name in names:
        if os.path.lexists(folder / name):
            move(folder / name, place / name)
    with suppress(OSError):
        folder.rmdir()
    return place


def archive_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move the files `names` of `folder`, as far as they exist, to one folder in its archive.

    If an engine was killed in between, the rest joins what it has moved. An older result of the
    same fingerprint, which still has some of these files, gets a number.

    Raises:
        RunFolderError: one cannot be moved, or the archive is a link.
    """
    place = archived(folder / ARCHIVED_RESULTS, fingerprint)
    found = [name for name in names if (folder / name).exists()]
    if any((place / name).exists() for name in found):
        move(place, _free(place))
    for name in found:
        move(folder / name, place / name)


def restore_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move the files that `archive_parts` archived under that fingerprint back.

    Files that `folder` has already stay, and so do their archived ones. Raises as `archive_parts`.
    """
    place = archived(folder / ARCHIVED_RESULTS, fingerprint)
    for name in names:
        if (place / name).exists() and not (folder / name).exists():
            move(place / name, folder / name)
    with suppress(OSError):  # missing, or not empty
        place.rmdir()


def archived(folder: Path, fingerprint: str) -> Path:
    """Where `archive` puts a folder; RunFolderError if its archive is a link."""
    mark = re.sub(r"[^0-9A-Za-z]", "-", fingerprint[:8])  # a damaged record may hold any text
    return own_folder(folder.parent, ARCHIVE, f"{folder.name}-{mark}")


def _free(place: Path) -> Path:
    """`place`, with a number appended if it exists: users may have moved folders by hand."""
    names = (place if k == 1 else place.with_name(f"{place.name}-{k}") for k in count(1))
    return next(path for path in names if not path.exists())


def move(source: Path, target: Path) -> None:
    """Move a file or folder; RunFolderError if that fails."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.rename(source, target)
    except OSError as error:
        raise RunFolderError(
            f"Cannot move {source} to {target} ({error.strerror or error}).",
            "Close the programs that have it open.",
        ) from error
