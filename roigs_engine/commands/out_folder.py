"""`--out` of a command that leads into a run folder: it must not be in use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..formats.lock import locked
from ..formats.run_files import LOCK, MANIFEST, is_own


@contextmanager
def claimed(out: Path | None) -> Iterator[None]:
    """Hold the lock of the run folder whose own files a command may overwrite.

    Args:
        out: where the command writes, if it does. Other folders in a run folder, such as
            `renders`, need no lock.

    Raises:
        RunFolderError: an engine is at work in that run folder.
    """
    folder = None if out is None else _run_folder(out.resolve())
    if folder is None:
        yield
        return
    with locked(folder, option="--out"):
        yield


def _run_folder(out: Path) -> Path | None:
    """The run folder that `out` is, or that has it among its own files."""
    for folder in (out, *out.parents):
        if (folder / MANIFEST).exists() or (folder / LOCK).exists():
            below = out.relative_to(folder).parts
            return folder if not below or is_own(below[0]) else None
    return None
