"""Temporary folders. The next process removes those of killed processes."""

from __future__ import annotations

import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from . import os_lock
from .files import is_link, matching, unlinked

OWNER = ".roigs-owner"
"""A file in each scratch folder; the folder's process keeps it locked."""
RANDOM = r"[a-z0-9_]{8}"  # what `mkdtemp` appends


@contextmanager
def scratch(prefix: str, place: Path | None = None) -> Iterator[Path]:
    """Create a folder `PREFIX...` for temporary files; remove it at the end.

    Folders with this prefix that killed processes of this user have left are removed, too.

    Args:
        prefix: of its name.
        place: the folder above it; None: the system's folder for temporary files.

    Raises:
        OSError: it cannot be made.
    """
    folder, owner = new_scratch(prefix, place)
    try:
        yield folder
    finally:
        remove_scratch(folder, owner)


def new_scratch(prefix: str, place: Path | None = None) -> tuple[Path, BinaryIO]:
    """Create a folder as `scratch` does; pass the returned pair to `remove_scratch`."""
    place = Path(tempfile.gettempdir()) if place is None else place
    for abandoned in matching(place, f"{prefix}*"):
        if re.fullmatch(re.escape(prefix) + RANDOM, abandoned.name):
            with suppress(OSError, os_lock.NoLocksError):
                _remove_abandoned(abandoned)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
        try:
            owner = open(folder / OWNER, "wb")  # noqa: SIM115 - open while the folder is there
        except FileNotFoundError:  # another process removed it as abandoned
            continue
        with suppress(os_lock.NoLocksError):
            if not os_lock.take(owner):  # another process is about to remove it
                owner.close()
                continue
        if (folder / OWNER).exists():
            return folder, owner
        owner.close()


def remove_scratch(folder: Path, owner: BinaryIO) -> None:
    """Remove a folder of `new_scratch`; ignores errors."""
    with suppress(OSError):
        owner.close()
    shutil.rmtree(folder, ignore_errors=True)


def _remove_abandoned(folder: Path) -> None:
    """Remove a folder of this user whose process has ended; OSError: it cannot be opened."""
    status = os.lstat(folder)
    if is_link(folder) or not stat.S_ISDIR(status.st_mode):
        return
    if hasattr(os, "getuid") and status.st_uid != os.getuid():
        return
    try:
        with open(folder / OWNER, "r+b", opener=unlinked) as owner:
            if not os_lock.take(owner):
                return
    except FileNotFoundError:
        folder.rmdir()  # if empty, its process was killed before it wrote the file
        return
    shutil.rmtree(folder, ignore_errors=True)
