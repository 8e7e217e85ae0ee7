"""Removes recreatable files from a run folder, never a result."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from ..errors import RunFolderError
from . import run_files
from .files import is_link, matching, read_record
from .stage_list import read_stage_list

# A file counts as the engine's if it is in a run folder and has a name that the engine gives.
_PICTURE = re.compile(r"[0-9a-f]{32}\.png")
_STAGE = re.compile(r".+-[0-9a-f]{8}(-damaged(-\d+)?)?")
_OF_A_STAGE = {
    *(run_files.STAGE, run_files.MODEL, run_files.CHECKPOINT, "checkpoint.before.bin"),
}


def is_run_folder(folder: Path) -> bool:
    """Whether an engine has worked in the folder, by its manifest or provenance."""
    manifest, provenance = folder / run_files.MANIFEST, folder / run_files.PROVENANCE
    return "config" in read_record(manifest) or "entries" in read_record(provenance)


def removable(run: Path) -> list[Path]:
    """Files that can go: undistorted photos and masks, stages of earlier settings, old previews.

    Results of earlier settings stay. The preview of a stopped training stays, too: it has no other
    result to look at.
    """
    if not is_run_folder(run):
        return []
    cache = run / run_files.CACHE
    folders = (cache / run_files.UNDISTORTED, cache / run_files.MASKS)
    found = [path for folder in folders for path in _own(folder, _PICTURE.fullmatch)]
    preview = run / run_files.PREVIEW
    if os.path.isfile(run / run_files.RESULT) and os.path.isfile(preview):
        found.append(preview)
    if present := {folder.name for folder in read_stage_list(run).values()}:
        for folder in matching(run / run_files.STAGES, "*"):
            if folder.name not in present and _STAGE.fullmatch(folder.name):
                found += _own(folder, _OF_A_STAGE.__contains__)
    return [path for path in found if not _is_linked(path, run)]


def _own(folder: Path, is_own: Callable[[str], object]) -> list[Path]:
    files = matching(folder, "*")
    return [path for path in files if is_own(path.name) and os.path.isfile(path)]


def remove(run: Path) -> int:
    """Remove these files and the folders that become empty; returns the bytes freed.

    RunFolderError: a file cannot be removed.
    """
    freed, found = 0, removable(run)
    for path in found:
        size = disk_size([path])
        try:
            path.unlink()
        except OSError as error:
            raise RunFolderError(
                f"Cannot remove {path} ({error.strerror or error}).",
                "Close the programs that have it open.",
            ) from error
        freed += size
    above = {folder for path in found for folder in path.parents if folder.is_relative_to(run)}
    for folder in sorted(above - {run}, reverse=True):  # inner folders first
        with suppress(OSError):  # the folder is not empty
            folder.rmdir()
    return freed


def disk_size(paths: Iterable[Path]) -> int:
    """Total bytes that files take, also in folders; unreadable ones count as 0, links as links."""
    total = 0
    for path in paths:
        names = (Path(parent, name) for parent, _, files in os.walk(path) for name in files)
        for file in (path, *names):
            with suppress(OSError):
                total += 0 if os.path.isdir(file) else os.lstat(file).st_size
    return total


def _is_linked(path: Path, run: Path) -> bool:
    """Whether `path` is a link or is reached through a link below the run folder."""
    above = [parent for parent in path.parents if parent != run and parent.is_relative_to(run)]
    return any(is_link(each) for each in (path, *above))
