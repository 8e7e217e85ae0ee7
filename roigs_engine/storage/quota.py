"""Disk quota for cached copies: removes the least recently used ones, never one in use.

Only folders made by `claim` are removed. Their name is a hash, and they contain a mark. The folder
above them may have other files of the user.
"""

from __future__ import annotations

import os
import re
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..context import QUIET, Context
from ..errors import ConfigError, RunFolderError
from ..formats.clean_up import disk_size
from ..formats.files import is_link, matching, own_folder
from ..formats.lock import holder, locked
from ..formats.run_files import BATCH_LOCK
from ..formats.run_files import LOCK as RUN_LOCK
from .urls import home

KINDS = ("scenes/*", "runs/*/*", "batches/*")
"""Patterns of the copies' folders: scenes, run folders, and files for a batch's page."""
COPY = re.compile(r"[0-9a-f]{20}")
"""Folder names from `urls.folder_of`."""
MARK = ".roigs-copy"
"""A file in each copy."""
REMOVED, LOCK = ".roigs-removed", "quota.lock"
LIMIT_VARIABLE = "ROIGS_CACHE_GB"
LIMIT = 50.0  # GB
WAIT = 0.5
IN_USE = 3600.0  # seconds after its last use for which a copy is kept: an engine may use it


def limit() -> float:
    """The limit for all copies, in bytes; ConfigError if the user's value is not a number."""
    text = os.environ.get(LIMIT_VARIABLE) or str(LIMIT)
    try:
        if (gigabytes := float(text)) >= 0:
            return 1e9 * gigabytes
    except ValueError:
        pass
    raise ConfigError(f"{LIMIT_VARIABLE} is '{text:.60}'.", "Use a number of gigabytes.")


def claim(context: Context, *folders: Path) -> None:
    """Create folders for copies and mark them as used; call `keep` within `IN_USE` seconds."""
    with alone(home(), LOCK, context):  # keeps `enforce_quota` from removing them meanwhile
        for folder in folders:
            make_copy(folder)
            os.utime(folder)


def make_copy(folder: Path) -> None:
    """Create a copy's folder, or a folder in it, with the mark.

    RunFolderError: it is a link. OSError: it cannot be created.
    """
    own_folder(home(), *folder.relative_to(home()).parts).mkdir(parents=True, exist_ok=True)
    mark = _copy_of(folder) / MARK
    if is_link(mark):
        mark.unlink()
    mark.touch()


def keep(folder: Path) -> None:
    """Mark a copy as used now."""
    with suppress(OSError):
        os.utime(folder)


def enforce_quota(context: Context = QUIET) -> None:
    """Remove the least recently used copies until the rest is within the limit.

    Files that cannot be removed stay until a later call.
    """
    left = limit()
    try:
        removed = own_folder(home(), REMOVED)  # do not follow links to other folders
    except RunFolderError:
        return
    with suppress(OSError, RunFolderError), alone(home(), LOCK, context):
        copies = {path: _last_used(path) for kind in KINDS for path in home().glob(kind)}
        folders = [path for path in copies if path.is_dir() and _is_ours(path)]
        for folder in sorted(folders, key=copies.__getitem__, reverse=True):
            left -= disk_size([folder])
            if left < 0 and time.time() - copies[folder] > IN_USE:
                removed.mkdir(exist_ok=True)
                with suppress(OSError):  # on Windows, if a file in it is open
                    folder.rename(removed / uuid.uuid4().hex)
    for folder in matching(removed, "[0-9a-f]" * 32):
        shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):  # the folder has other files
        removed.rmdir()


def _copy_of(folder: Path) -> Path:
    """The folder with the mark: two below the home of all copies."""
    return home().joinpath(*folder.relative_to(home()).parts[:2])


def _is_ours(folder: Path) -> bool:
    copy = _copy_of(folder)
    below = [path for path in (folder, *folder.parents) if path.is_relative_to(home())]
    linked = any(is_link(path) for path in below if path != home())
    return bool(COPY.fullmatch(copy.name)) and (copy / MARK).is_file() and not linked


def _last_used(folder: Path) -> float:
    """When a copy was last used; now, if a batch or an engine holds it, because clocks jump."""
    if any(holder(folder / name) for name in (BATCH_LOCK, RUN_LOCK)):
        return time.time()
    with suppress(OSError):
        return folder.stat().st_mtime
    return time.time()


@contextmanager
def alone(folder: Path, name: str, context: Context) -> Iterator[None]:
    """Wait for a lock of a folder on this machine, and hold it."""
    folder.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            with locked(folder, context.warn, option=None, name=name):
                yield
            return
        except RunFolderError as error:
            if not isinstance(error.__cause__, BlockingIOError):
                raise
        context.check_cancelled()
        time.sleep(WAIT)
