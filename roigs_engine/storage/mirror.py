"""Copies of scenes on this machine: each file is read once, within a disk quota."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from ..context import Context
from ..errors import ConfigError, EngineError
from ..formats.files import own_file, read_json, remove_leftovers, write_json, written_by_name
from ..formats.names import inner_path
from .quota import alone, claim, enforce_quota, keep, limit
from .urls import FileSystem, StoreError, file_system, folder_of, guarded

SCENES, FILES, INDEX, LOCK = "scenes", "files", "index.json", "copy.lock"
LONGEST = 255  # bytes of a file name, on any file system


def mirror(url: str, context: Context) -> Path:
    """Update the copy of a scene's folder and return it; only changed files are read.

    ConfigError: there is no such folder, or a name there cannot be a file here. StoreError: it
    cannot be read.
    """
    found, place = file_system(url, context.should_stop)
    limit()
    folder = folder_of(url, SCENES)
    claim(context, folder)
    with alone(folder, LOCK, context):
        remove_leftovers(folder)
        files = _listed(found, place, url)
        known = _index(folder)
        changed = [n for n, sign in files.items() if not _is_here(folder, n, sign, known.get(n))]
        if known.keys() & set(changed):  # forget copies before they change, in case of a kill
            known = {name: sign for name, sign in known.items() if name not in set(changed)}
            write_json(folder / INDEX, known)
        for name in changed:
            context.check_cancelled()
            with guarded(f"{url} ({name})"):
                _copy(found, f"{place}/{name}", _target(folder, name), files[name][0])
            known[name] = files[name]
        for name in filter(inner_path, known.keys() - files.keys()):
            with suppress(EngineError, OSError):
                _target(folder, name).unlink()
        write_json(folder / INDEX, {name: known[name] for name in files})
        keep(folder)
    enforce_quota(context)
    return folder / FILES


def _is_here(folder: Path, name: str, sign: list[Any], known: Any) -> bool:
    """Whether the copy of a file exists, and equals the store's present file."""
    target = _target(folder, name)
    return known == sign and target.is_file() and target.stat().st_size == sign[0]


def _target(folder: Path, name: str) -> Path:
    """The path of a file's copy; RunFolderError: it leads through a link."""
    return own_file(folder, f"{FILES}/{name}")


def _listed(found: FileSystem, place: str, url: str) -> dict[str, list[Any]]:
    """List the files below the folder: name -> `sign`."""
    with guarded(url):
        listed = found.find(place, detail=True)
    if not listed:
        raise ConfigError(f"There is nothing at {url}.", "Correct the address.")
    paths = {str(path)[len(place) :].removeprefix("/"): path for path in listed}
    names = {name: listed[path] for name, path in paths.items()}
    # On some stores, empty objects stand for folders, with or without a slash at the end.
    folders = {str(above) for name in names for above in PurePosixPath(name).parents}
    files = {}
    for name, facts in names.items():
        empty = not facts.get("size")
        if not name or name.endswith("/") or (name in folders and empty):
            continue
        lengths = [len(part.encode("utf-8", "replace")) for part in name.split("/")]
        if name in folders or min(lengths) == 0 or max(lengths) > LONGEST:
            text = f"{name!a:.100}, a name at {url:.100}, cannot name a file here."
            raise ConfigError(text, "Rename it there.")
        if inner_path(name):
            with suppress(FileNotFoundError):  # a broken link of a web page
                known = facts.get("size") is not None
                files[name] = sign(facts if known else found.info(paths[name]))
    return files


def sign(facts: Mapping[str, Any]) -> list[Any]:
    """A file's size, and a mark that changes with its content, from the store's facts.

    StoreError: the store does not report the size.
    """
    if facts.get("size") is None:
        raise StoreError(
            f"The store does not report the size of {facts.get('name')!a:.100}.",
            "Copy the folder to this machine, or use another store.",
        )
    marks = ("ETag", "etag", "md5", "mtime", "created", "LastModified")
    return [int(facts["size"]), next((str(facts[key]) for key in marks if facts.get(key)), "")]


def _copy(found: FileSystem, source: str, target: Path, size: int) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with written_by_name(target) as temporary:
        found.get_file(source, str(temporary))
        if temporary.stat().st_size != size:
            raise OSError("the file changed while it was read")
        os.replace(temporary, target)


def _index(folder: Path) -> dict[str, Any]:
    try:
        found = read_json(folder / INDEX)
    except EngineError:
        return {}
    return found if isinstance(found, dict) else {}
