"""Environments of **Set Up the Engine**: locks while they are used, and their removal. No bpy.

Several Blenders share them. So each engine that runs in an environment holds a lock in it. A
process that makes or removes environments holds the lock of their folder.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ..errors import AddonError
from ..shared import EngineError, clean_up, files, lock, run_files
from .python import MARKER, complete_environments

SETUP_LOG, DOWNLOADS = "setup.log", "downloads"
"""Beside the environments: output of the last set-up; pip's cache until the set-up succeeds."""

USES = "uses"
"""Folder in an environment with a lock for each engine that runs in it."""


def made(folders: Iterable[Path]) -> list[Path]:
    """Return all environments in the folders, incomplete ones too."""
    return [
        path
        for folder in folders
        for path in files.matching(folder, "*")
        if path.name.isdecimal() and os.path.isdir(path) and not files.is_link(path)
    ]


@contextmanager
def using(python: Path) -> Iterator[None]:
    """Keep the environment of a Python from being removed while the block runs.

    A Python outside these environments is never removed, so it needs no lock.

    Raises:
        OSError: the environment was removed just now.
    """
    environment = python.parent.parent
    marker = environment / MARKER
    with ExitStack() as stack:
        if marker.is_file():
            with suppress(EngineError):  # not writable, so not removable from here either
                stack.enter_context(lock.locked(environment / USES / secrets.token_hex(4)))
            if not marker.is_file():
                raise FileNotFoundError(errno.ENOENT, "The engine was removed", str(environment))
        yield


def user(environment: Path) -> int:
    """Return a process that runs an engine in the environment; 0 if there is none."""
    locks = environment.glob(f"{USES}/*/{run_files.LOCK}")
    return next(filter(None, map(lock.holder, locks)), 0)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Lock a folder, so that no other process makes or removes environments during the block.

    Raises:
        AddonError: another process holds the lock, or the folder cannot be written to.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(lock.locked(folder))
        except EngineError as error:
            if pid := lock.holder(folder / run_files.LOCK):
                text = f"Process {pid} is setting up the engine. Wait until it has finished."
                raise AddonError(text) from error
            raise AddonError(str(error)) from error
        yield


def remove(environment: Path) -> bool:
    """Remove an environment, unless an engine runs in it; return whether it is gone."""
    marker, aside = environment / MARKER, environment / f"{MARKER}.removed"
    with suppress(OSError):
        os.replace(marker, aside)  # from now on, no engine starts in it
    if marker.exists() or user(environment):
        with suppress(OSError):
            os.replace(aside, marker)
        return False
    shutil.rmtree(environment, ignore_errors=True)
    return not environment.exists()


def remove_replaced(folders: Iterable[Path]) -> None:
    """Remove incomplete environments, and all but the newest complete one; not those in use."""
    newest = complete_environments(folders)[:1]
    for environment in made(folders):
        if environment not in newest:
            remove(environment)


def remove_all(folders: Iterable[Path]) -> int:
    """Remove every environment with its logs and downloads; return the bytes freed.

    Raises:
        AddonError: one is in use, an installation runs, or something cannot be removed.
    """
    freed = 0
    for folder in filter(os.path.isdir, folders):
        with alone(folder):
            there = made([folder])
            if pid := next(filter(None, map(user, there)), 0):
                raise AddonError(f"An engine is running (process {pid}). Stop it first.")
            freed += clean_up.disk_size(there)
            for environment in there:
                if not remove(environment):
                    raise AddonError(f"Cannot remove {environment}. Remove it by hand.")
            shutil.rmtree(folder / DOWNLOADS, ignore_errors=True)
            with suppress(OSError):
                (folder / SETUP_LOG).unlink()
    return freed
