"""`batch.json`: what a batch has finished, so that it is not done again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import EngineError, RunFolderError
from ..formats.files import read_json, write_json
from ..formats.run_files import BATCH, MANIFEST, REPORT_DATA, RESULT
from ..formats.text import json_digest
from ..run.definition import Run
from ..run.manifest import from_json, manifest_difference, read_manifest

VERSION = 1


class BatchRecord:
    """The finished scenes of the folder of a batch.

    Args:
        folder: of the batch.
    """

    def __init__(self, folder: Path) -> None:
        """Read the record; one that is missing or damaged counts as empty."""
        self.folder = folder
        self._scenes: dict[str, Any] = {}
        try:
            found = read_json(folder / BATCH)
            if found["version"] == VERSION:
                self._scenes = dict(found["scenes"])
        except (EngineError, KeyError, TypeError, ValueError):
            pass

    def is_done(self, name: str, row: str, run: Run, files: Iterable[Path]) -> bool:
        """Whether a scene is finished as the table has it now.

        Args:
            name: of the scene.
            row: digest of its row.
            run: of its row; its photos are hashed if an engine has read them before.
            files: what it writes.
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
        """Write down that a scene is finished.

        Args:
            name, row, files: as `is_done`.
            folder: of its run.

        Raises:
            RunFolderError: a file of the scene cannot be read (a network drive may show it late)
                or the record cannot be written.
        """
        try:
            self._scenes[name] = {
                "row": row,
                "manifest": json_digest(read_manifest(folder / MANIFEST)),
                "files": self._stamps(folder, files),
            }
        except OSError as error:
            raise RunFolderError(f"Cannot read {error.filename} ({error.strerror}).") from error
        write_json(self.folder / BATCH, {"version": VERSION, "scenes": self._scenes})

    def _stamps(self, run: Path, files: Iterable[Path]) -> dict[str, list[Any]]:
        """Size and time of files, by their place in the batch's folder; OSError if one is gone."""
        found = {}
        for path in (run / RESULT, run / REPORT_DATA, *files):
            status = path.stat()
            place = path.relative_to(self.folder).as_posix()
            found[place] = [status.st_size, status.st_mtime_ns]
        return found
