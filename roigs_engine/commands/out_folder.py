"""Where a command writes: not to a run's own files, and not to what it reads."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from ..errors import ConfigError
from ..formats.run_files import LOCK, MANIFEST, SPLIT, is_own


def refuse_run_files(out: Path | None, *, option: str = "--out") -> None:
    """Refuse a place where a command may replace the own files of a run.

    Args:
        out: where the command writes, if it does. Other folders in a run folder, such as
            `renders`, are free.
        option: the one that names `out`. A `--run-dir` may be a run folder, but not lie in another.

    Raises:
        ConfigError: it is a run folder, or one of its own files or folders.
    """
    folder = None if out is None else _run_folder(out, above=option == "--run-dir")
    if folder is not None:
        free = folder / ("other.ply" if out and out.suffix.lower() == ".ply" else "other")
        raise ConfigError(
            f"{option} {out} would replace files of the run in {folder}.",
            f"Choose another place; in that folder, {free} is free.",
        )


def refuse_inputs(
    outputs: Iterable[Path], inputs: Iterable[Path | None], hint: str = "Choose another --out."
) -> None:
    """Raise ConfigError, with the hint, if a command would replace one of the files it reads."""
    given = [path for path in inputs if path is not None]
    for output in outputs:
        if any(_is_same(output, path) for path in given):
            raise ConfigError(f"{output} is an input of this command.", hint)


def _is_same(path: Path, other: Path) -> bool:
    """Whether two names stand for one file."""
    with suppress(OSError):
        return os.path.samefile(path, other)
    return False


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
