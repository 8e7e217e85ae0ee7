"""Results of commands; refuses outputs that would replace inputs or a run's files."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Self

from ..errors import ConfigError, EngineError
from ..formats import run_files
from ..formats.run_files import LOCK, MANIFEST, SPLIT, is_own
from ..requests.values import shown


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of a command; each field with a path is a file or folder that it wrote."""

    files: dict[str, Path] = field(default_factory=dict)  # more files or folders, by name
    text: str = ""  # the command's answer on standard output

    @property
    def error(self) -> EngineError | None:
        """Return the failure of a part of the work if the rest was done; None without one."""
        return None

    @property
    def outputs(self) -> dict[str, str]:
        """Return name -> path of all files and folders written."""
        named = {each.name: getattr(self, each.name) for each in fields(self)}
        found = {name: value for name, value in named.items() if isinstance(value, Path)}
        return {name: str(path) for name, path in (found | self.files).items()}

    def with_places(self, *lines: str) -> Self:
        """Return the result with these lines as its text, followed by the outputs' paths."""
        places = (f"{what + ':':10}{path}" for what, path in self.outputs.items())
        return replace(self, text="\n".join([*lines, *places]))


@dataclass(frozen=True, kw_only=True)
class Evaluated(Result):
    """An evaluation's report, page, pictures, and table as Markdown; None without an evaluation."""

    report: Path | None = None
    page: Path | None = None
    pictures: Path | None = None
    table: str = ""

    def with_evaluation(self, folder: Path, table: str) -> Self:
        """Return the result with the evaluation in a folder; its text begins with the table."""
        report, page = folder / run_files.REPORT, folder / run_files.REPORT_PAGE
        pictures = folder / run_files.CROPS
        found = replace(self, report=report, page=page, pictures=pictures, table=table)
        return found.with_places(table)


@dataclass(frozen=True, kw_only=True)
class Trained(Evaluated):
    """The result of a training: the scene's PLY, and the folder with a PLY for each box."""

    result: Path | None = None
    rois: Path | None = None


def result_in(folder: Path, table: str | None) -> Trained:
    """Return the paths of a run folder; `table` is the evaluation's, None without one."""
    found = Trained(result=folder / run_files.RESULT, rois=folder / run_files.FINE)
    return found if table is None else found.with_evaluation(folder, table)


def refuse_run_files(out: Path | None, *, option: str = "--out") -> None:
    """Refuse an output path where a command would replace a run's own files.

    Args:
        out: the output path, if any. Other folders in a run folder, such as `renders`, are allowed.
        option: the option of `out`. A `--run-dir` may be a run folder, but not lie in another.

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


def named_files(option: str, texts: Iterable[str], form: str) -> dict[str, Path]:
    """Parse an option's values such as `NAME=FILE` into name -> path; `form` is for errors.

    ConfigError: a name or a path is missing, or a name occurs twice.
    """
    found: dict[str, Path] = {}
    for text in texts:
        name, separator, path = text.partition("=")
        if not separator or not name.strip():
            raise ConfigError(f"{option} {shown(text)} has no name.", f"Write {form}.")
        if not path.strip():
            raise ConfigError(f"{option} {shown(text)} has no file.", f"Write {form}.")
        if name in found:
            raise ConfigError(f"{option} names '{name}' twice.", "Give each its own name.")
        found[name] = Path(path)
    return found


def _is_same(path: Path, other: Path) -> bool:
    """Whether two paths are one file."""
    with suppress(OSError):
        return os.path.samefile(path, other)
    return False


def _run_folder(out: Path, *, above: bool) -> Path | None:
    """Return the run folder that `out` is, or whose own file it is; None if neither."""
    out = Path(os.path.realpath(out))
    for folder in out.parents if above else (out, *out.parents):
        if _is_there(folder, LOCK) or _is_there(folder, MANIFEST, SPLIT):
            below = out.relative_to(folder).parts
            return folder if not below or is_own(below[0]) else None
    return None


def _is_there(folder: Path, *names: str) -> bool:
    return all(os.path.lexists(folder / name) for name in names)
