"""Copies of scenes on this machine: each file is read once, within a limit of the disk."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from ..context import Context
from ..errors import ConfigError, EngineError, RunFolderError
from ..formats.files import read_json, write_json
from ..formats.lock import locked
from .urls import file_system, folder_of, home

SCENES, FILES, INDEX, LOCK = "scenes", "files", "index.json", "copy.lock"
LIMIT_VARIABLE = "ROIGS_CACHE_GB"
LIMIT = 50.0  # GB
WAIT = 0.5
IN_USE = 3600.0  # seconds for which a copy stays: an engine may be at work on it


def mirror(url: str, context: Context) -> Path:
    """A copy of a scene's folder, brought up to date: only files that changed are read.

    Args:
        url: of the folder.
        context: told of the work; checked for cancellation.

    Raises:
        ConfigError: there is no such folder, or it cannot be read.
    """
    found, place = file_system(url)
    _limit()
    folder = folder_of(url, SCENES)
    with _alone(folder, context):
        files = _listed(found, place, url)
        known = _index(folder)
        for name, sign in files.items():
            context.check_cancelled()
            target = folder / FILES / name
            here = target.stat().st_size if target.is_file() else -1
            if known.get(name) != sign or here != sign[0]:
                _copy(found, f"{place}/{name}", target, sign[0], url)
                known[name] = sign
        for name in known.keys() - files.keys():
            (folder / FILES / name).unlink(missing_ok=True)
        write_json(folder / INDEX, {name: known[name] for name in files})
        os.utime(folder)
        _make_room(folder, sum(sign[0] for sign in files.values()))
    return folder / FILES


def keep(url: str) -> None:
    """Note that the copy of a folder is in use."""
    with suppress(OSError):
        os.utime(folder_of(url, SCENES))


def _listed(found: Any, place: str, url: str) -> dict[str, list[Any]]:
    """File below the folder -> its size and what changes with its content."""
    try:
        listed = found.find(place, detail=True)
    except Exception as error:
        raise _unreadable(url, error) from error
    if not listed:
        raise ConfigError(f"There is nothing at {url}.", "Correct the address.")
    files = {}
    for path, facts in listed.items():
        name = str(path)[len(place) :].lstrip("/")
        if not name or ".." in PurePosixPath(name).parts:
            continue
        files[name] = sign(facts)
    return files


def sign(facts: Mapping[str, Any]) -> list[Any]:
    """What changes with a file, of what a store tells: its size, and a mark of its content."""
    marks = ("ETag", "etag", "md5", "mtime", "created", "LastModified")
    return [int(facts["size"]), next((str(facts[key]) for key in marks if facts.get(key)), "")]


def _copy(found: Any, source: str, target: Path, size: int, url: str) -> None:
    """Copy a file whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    number, name = tempfile.mkstemp(dir=target.parent)
    os.close(number)
    try:
        found.get_file(source, name)
        if os.path.getsize(name) != size:
            raise OSError("the file changed while it was read")
        os.replace(name, target)
    except Exception as error:
        raise _unreadable(f"{url} ({target.name})", error) from error
    finally:
        Path(name).unlink(missing_ok=True)


def _index(folder: Path) -> dict[str, Any]:
    try:
        found = read_json(folder / INDEX)
    except EngineError:
        return {}
    return found if isinstance(found, dict) else {}


def _limit() -> float:
    """Bytes that all copies may take; ConfigError if the user's number is none."""
    text = os.environ.get(LIMIT_VARIABLE) or str(LIMIT)
    try:
        if (gigabytes := float(text)) >= 0:
            return 1e9 * gigabytes
    except ValueError:
        pass
    raise ConfigError(f"{LIMIT_VARIABLE} is '{text:.60}'.", "Use a number of gigabytes.")


def _make_room(current: Path, size: int) -> None:
    """Remove the copies that were used longest ago, until all are within the limit."""
    limit = _limit() - size
    others = [f for f in current.parent.iterdir() if f.is_dir() and f != current]
    for folder in sorted(others, key=lambda f: f.stat().st_mtime, reverse=True):
        limit -= sum(sign[0] for sign in _index(folder).values())
        if limit < 0 and time.time() - folder.stat().st_mtime > IN_USE:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _alone(folder: Path, context: Context) -> Iterator[None]:
    """Hold a folder here, once no other process brings it up to date."""
    home().mkdir(parents=True, exist_ok=True)
    while True:
        try:
            with locked(folder, context.warn, option=None, name=LOCK):
                yield
            return
        except RunFolderError as error:
            if not isinstance(error.__cause__, BlockingIOError):
                raise
        context.check_cancelled()
        time.sleep(WAIT)


def _unreadable(url: str, error: Exception) -> ConfigError:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return ConfigError(f"Cannot read {url} ({reason:.100}).", "Is the address right, and allowed?")
