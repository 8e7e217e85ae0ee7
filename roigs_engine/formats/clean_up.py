"""What a run folder can lose: only what the engine makes again when it needs it, never a result."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from ..errors import RunFolderError
from . import run_files
from .files import is_link, matching
from .stage_list import read_stage_list


def is_run_folder(folder: Path) -> bool:
    """Whether an engine has worked in the folder."""
    return any(os.path.isfile(folder / name) for name in (run_files.MANIFEST, run_files.PROVENANCE))


def removable(run: Path) -> list[Path]:
    """What can be removed: undistorted photos and masks, stages of earlier settings, old previews.

    Results of earlier settings stay, and so does the preview of a training that was stopped: it is
    all there is to look at.
    """
    if not is_run_folder(run):
        return []
    cache = run / run_files.CACHE
    found = [cache / run_files.UNDISTORTED, cache / run_files.MASKS]
    if os.path.isfile(run / run_files.RESULT):
        found.append(run / run_files.PREVIEW)
    if present := {folder.name for folder in read_stage_list(run).values()}:
        stages = matching(run / run_files.STAGES, "*")
        found += [folder for folder in stages if folder.name not in present]
    return [path for path in found if os.path.exists(path) and not _is_linked(path, run)]


def remove(run: Path) -> int:
    """Remove it; returns the bytes that were freed.

    Raises:
        RunFolderError: something cannot be removed.
    """
    freed = 0
    for path in removable(run):
        size = disk_size([path])
        try:
            if os.path.isdir(path):
                shutil.rmtree(path)
            else:
                path.unlink()
        except OSError as error:
            raise RunFolderError(
                f"Cannot remove {path} ({error.strerror or error}).",
                "Close the programs that have it open.",
            ) from error
        freed += size
        with suppress(OSError):  # not empty
            path.parent.rmdir()
    return freed


def disk_size(paths: Iterable[Path]) -> int:
    """Bytes of files, and of those in folders; what cannot be read counts as nothing."""
    total = 0
    for path in paths:
        names = (Path(parent, name) for parent, _, files in os.walk(path) for name in files)
        for file in (path, *names):
            with suppress(OSError):
                total += 0 if os.path.isdir(file) else os.lstat(file).st_size
    return total


def _is_linked(path: Path, run: Path) -> bool:
    """Whether it is a link, or reached through one below the run folder."""
    above = [parent for parent in path.parents if parent != run and parent.is_relative_to(run)]
    return any(is_link(each) for each in (path, *above))
