"""What a run made for another request: kept in `older/` of its folder, and taken back when asked.

Names there end in the first eight digits of a fingerprint, so that a run can go to and fro between
requests without anything being deleted or made twice.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path

from ..errors import RunFolderError

FOLDER, PARTS = "older", "results"


def put_away(folder: Path, fingerprint: str) -> None:
    """Move a folder to `older` beside it, if it is there.

    Raises:
        RunFolderError: it cannot be moved.
    """
    if folder.exists():
        _move(folder, _free(_place(folder, fingerprint)))


def take_back(folder: Path, fingerprint: str) -> None:
    """Move what was put away of `folder` under that fingerprint back, unless something is there."""
    place = _place(folder, fingerprint)
    if place.exists() and not folder.exists():
        _move(place, folder)


def put_away_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move those of `names` that are in `folder` to a folder of their own in `folder`/older."""
    place = _free(_place(folder / PARTS, fingerprint))
    for name in names:
        if (folder / name).exists():
            _move(folder / name, place / name)


def take_back_parts(folder: Path, names: Iterable[str], fingerprint: str) -> None:
    """Move what was put away by `put_away_parts` under that fingerprint back."""
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
            "Close what has it open.",
        ) from error
