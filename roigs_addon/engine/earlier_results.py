"""Lists and deletes results of earlier settings in a run folder. No bpy."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from ..errors import AddonError
from ..shared import EngineError, clean_up, files, run_files
from . import report, run_settings
from .run_settings import RunSettings


@dataclass(frozen=True, kw_only=True)
class EarlierResult:
    """A result that another training has replaced.

    Attributes:
        folder: laid out like a run folder.
        made: time of training, in seconds since the epoch.
        size: bytes on disk.
        settings: of its training.
        psnr: in words; empty if it was not measured.
    """

    folder: Path
    made: float
    size: int
    settings: RunSettings
    psnr: str


def earlier_results(run: Path) -> list[EarlierResult]:
    """Return the earlier results of a run folder, newest first."""
    found = []
    for folder in files.matching(run / run_files.EARLIER, "*"):
        try:
            made = (folder / run_files.RESULT).stat().st_mtime
            if not os.path.isfile(folder / run_files.BACKGROUND):
                continue
            size = clean_up.disk_size([folder])
        except OSError:
            continue  # not complete, or being moved right now
        settings = run_settings.read(folder)
        psnr = report.psnr(folder, settings.max_side)
        found.append(
            EarlierResult(folder=folder, made=made, size=size, settings=settings, psnr=psnr)
        )
    return sorted(found, key=lambda result: result.made, reverse=True)


def delete(run: Path, name: str) -> None:
    """Delete an earlier result; its stages stay.

    Raises:
        AddonError: there is no such result, or it cannot be deleted.
    """
    known = {result.folder.name: result.folder for result in earlier_results(run)}
    if name not in known:
        raise AddonError("This result was deleted already.")
    try:
        files.own_folder(run, run_files.EARLIER, name)
        shutil.rmtree(known[name])
    except EngineError as error:
        raise AddonError(f"Cannot delete {known[name]}: {error.message}") from error
    except OSError as error:
        raise AddonError(f"Cannot delete {known[name]} ({error.strerror or error}).") from error
