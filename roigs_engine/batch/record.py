"""`batch.json`: the finished work of a batch, so that it is not repeated."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import EngineError, RunFolderError
from ..formats.files import read_json, write_json
from ..formats.names import inner_path
from ..formats.run_files import BATCH, BATCH_OUTPUTS, MANIFEST, REPORT_DATA, RESULT
from ..formats.text import json_digest
from ..run.definition import Run
from ..run.manifest import from_json, manifest_difference, read_manifest

VERSION = 2


@dataclass(frozen=True, kw_only=True)
class Output:
    """A file that a batch writes beside its run folders."""

    name: str  # path in the folder of outputs
    source: Path  # the PLY that is converted
    path: Path  # path of the file
    options: tuple[str, ...] = ()  # words of the command line that writes it


class BatchRecord:
    """The finished scenes of a batch's folder.

    Attributes:
        folder: the batch's.
        was_there: whether an earlier batch has written the record.
    """

    def __init__(self, folder: Path) -> None:
        """Read the record; a missing or damaged one counts as empty."""
        self.folder = folder
        self._scenes: dict[str, Any] = {}
        self.was_there = False
        try:
            found = read_json(folder / BATCH)
            if found["version"] == VERSION:
                self._scenes = dict(found["scenes"])
                self.was_there = True
        except (EngineError, KeyError, TypeError, ValueError):
            pass

    def begin(self) -> None:
        """Write the record if it is missing: it marks the folder as a batch's."""
        if not self.was_there:
            self._write()

    def is_done(self, name: str, row: str, run: Run, files: Iterable[Path]) -> bool:
        """Whether the run of a scene is finished with the table's present settings.

        Args:
            row: digest of the scene's row.
            run: of the row; its photos are hashed if an engine has read them before.
            files: of the run, used by outputs.
        """
        known = self._scenes.get(name)
        if not isinstance(known, dict) or known.get("row") != row:
            return False
        try:
            before = read_manifest(run.folder / MANIFEST)
            return (
                known.get("manifest") == json_digest(before)
                and known.get("files") == self._stamps(run.folder, files)
                and not manifest_difference(before, from_json(run.manifest()))
            )
        except (EngineError, OSError):
            return False

    def add(self, name: str, row: str, folder: Path, files: Iterable[Path]) -> None:
        """Record that the run of a scene, in `folder`, is finished; see `is_done`.

        RunFolderError: a file cannot be read (a network drive may show it late), or written.
        """
        try:
            self._scenes[name] = {
                "row": row,
                "manifest": json_digest(read_manifest(folder / MANIFEST)),
                "files": self._stamps(folder, files),
                "outputs": {},
            }
        except OSError as error:
            raise _unreadable(error) from error
        self._write()

    def has_output(self, name: str, output: Output) -> bool:
        """Whether a scene's output exists, made with the table's present settings."""
        try:
            made = self._made(name).get(output.name)
            return made == [list(output.options), self._stamp(output.path)]
        except (EngineError, OSError):
            return False

    def add_output(self, name: str, output: Output) -> None:
        """Record that an output of a scene was made; raises as `add`."""
        try:
            stamp = self._stamp(output.path)
        except OSError as error:
            raise _unreadable(error) from error
        self._made(name)[output.name] = [list(output.options), stamp]
        self._write()

    def left_over(self, name: str, outputs: Iterable[Output]) -> list[str]:
        """The existing outputs of a scene that the table no longer has."""
        found = []
        known = filter(inner_path, self._made(name))
        for place in sorted({*known} - {output.name for output in outputs}):
            with suppress(OSError):
                self._stamp(self.folder / BATCH_OUTPUTS / place)
                found.append(place)
        return found

    def _made(self, name: str) -> dict[str, Any]:
        """The recorded outputs of a scene: path -> options and stamp."""
        known = self._scenes.get(name)
        found = known.get("outputs") if isinstance(known, dict) else None
        return found if isinstance(found, dict) else {}

    def _write(self) -> None:
        write_json(self.folder / BATCH, {"version": VERSION, "scenes": self._scenes})

    def _stamps(self, run: Path, files: Iterable[Path]) -> dict[str, list[Any]]:
        """Stamps of files, by their path in the batch's folder; OSError if one is missing."""
        paths = (run / RESULT, run / REPORT_DATA, *files)
        return {path.relative_to(self.folder).as_posix(): self._stamp(path) for path in paths}

    def _stamp(self, path: Path) -> list[Any]:
        """A stamp that changes with a file: size and time; OSError if it is missing."""
        status = path.stat()
        return [status.st_size, status.st_mtime_ns]


def _unreadable(error: OSError) -> RunFolderError:
    return RunFolderError(f"Cannot read {error.filename} ({error.strerror}).")
