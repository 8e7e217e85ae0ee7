"""Where a command writes: not to the files of a run that an engine works on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..formats.lock import locked
from ..formats.run_files import LOCK, MANIFEST, SPLIT, is_own


@contextmanager
def claimed(out: Path | None, *, option: str = "--out") -> Iterator[None]:
    """Hold the lock of the run folder whose own files a command may overwrite.

    Args:
        out: where the command writes, if it does. Other folders in a run folder, such as
            `renders`, need no lock.
        option: the one that names `out`. Of `--run-dir`, only the run folders above it count.

    Raises:
        RunFolderError: an engine is at work in that run folder.
    """
    folder = None if out is None else _run_folder(out, above=option == "--run-dir")
    if folder is None:
        yield
        return
    with locked(folder, option=option):
        yield


def _run_folder(out: Path, *, above: bool) -> Path | None:
    """The run folder that `out` is, or that has it among its own files."""
    out = Path(os.path.realpath(out))
    for folder in out.parents if above else (out, *out.parents):
        if _is_there(folder, LOCK) or _is_there(folder, MANIFEST, SPLIT):
            below = out.relative_to(folder).parts
            return folder if not below or is_own(below[0]) else None
    return None


def _is_there(folder: Path, *names: str) -> bool:
    """Whether the folder has files of these names; False if it cannot be read."""
    return all(os.path.lexists(folder / name) for name in names)
