"""What a run made for other settings: kept in `archive/` of its folder, and restored when asked.

Names there end in the first eight digits of a fingerprint, so that a run can go to and fro between
settings without anything being deleted or made twice.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path

from ..errors import RunFolderError

FOLDER, PARTS = "archive", "results"


def archive(folder: Path, fingerprint: str) -> None:
    """Move a folder or file to `archive` beside it, if it is there.

    Raises:
        RunFolderError: it cannot be moved.
    """
    if folder.exists():
        _move(folder, _free(_place(folder, fingerprint)))


def restore(folder: Path, fingerprint: str) -> None:
    """Move what was archived of `folder` under that fingerprint back, unless something is there."""
    place = _place(folder, fingerprint)
    if place.exists() and not folder.exists():
        _move(place, folder)


def archive_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move those of `names` that are in `folder` to a folder of their own in `folder`/archive."""
    place = _free(_place(folder / PARTS, fingerprint))
    for name in names:
        if (folder / name).exists():
            _move(folder / name, place / name)


def restore_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move what `archive_parts` archived under that fingerprint back."""
    place = _place(folder / PARTS, fingerprint)
    for name in names:
        if (place / name).exists() and not (folder / name).exists():
            _move(place / name, folder / name)
    with suppress(OSError):  # not there, or not empty
        place.rmdir()


def _place(folder: Path, fingerprint: str) -> Path:
    return folder.parent / FOLDER / f"{folder.name}-{fingerprint[:8]}"


def _free(place: Path) -> Path:
    """`place`, or that with a number when somebody has moved folders there by hand."""
    names = (place if k == 1 else place.with_name(f"{place.name}-{k}") for k in count(1))
    return next(path for path in names if not path.exists())


def _move(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.rename(source, target)
    except OSError as error:
        raise RunFolderError(
            f"Cannot move {source} to {target} ({error.strerror or error}).",
            "Close the programs that have it open.",
        ) from error
