"""Moves aside results of other settings and damaged stages before a run replaces them.

Stages need no moving: their folders are named after their fingerprints.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path

from ..errors import RunFolderError
from ..formats.files import own_folder
from ..formats.run_files import EARLIER, RESULTS


def set_aside(run: Path, digest: str) -> None:
    """Move the results of a whole run to `earlier/DIGEST`, the digest of their manifest.

    If an engine was killed in between, the remaining results follow. RunFolderError if one cannot
    be moved, or a folder is a link.
    """
    place = _place(run, digest)
    found = [name for name in RESULTS if os.path.lexists(run / name)]
    if any(os.path.lexists(place / name) for name in found):  # after a manifest was deleted
        _move(place, _free(place))
    for name in found:
        _move(run / name, place / name)


def bring_back(run: Path, digest: str) -> None:
    """Move the results of `set_aside` for that manifest back; replaces nothing, raises alike."""
    place = _place(run, digest)
    for name in RESULTS:
        if os.path.lexists(place / name) and not os.path.lexists(run / name):
            _move(place / name, run / name)
    for folder in (place, place.parent):
        with suppress(OSError):  # missing, or not empty
            folder.rmdir()


def move_damaged(folder: Path, names: Iterable[str]) -> Path:
    """Move files of a stage's folder to `FOLDER-damaged` beside it; returns that folder."""
    place = _free(folder.with_name(f"{folder.name}-damaged"))
    for name in names:
        if os.path.lexists(folder / name):
            _move(folder / name, place / name)
    return place


def _place(run: Path, digest: str) -> Path:
    return own_folder(run, EARLIER, digest[:8])


def _free(place: Path) -> Path:
    """`place`, with a number appended if it exists."""
    names = (place if k == 1 else place.with_name(f"{place.name}-{k}") for k in count(1))
    return next(path for path in names if not os.path.lexists(path))


def _move(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.rename(source, target)
    except OSError as error:
        raise RunFolderError(
            f"Cannot move {source} to {target} ({error.strerror or error}).",
            "Close the programs that have it open.",
        ) from error
