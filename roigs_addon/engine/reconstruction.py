"""Reads the folder of a reconstruction (docs/files.md, section Reconstruction). No bpy."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from pathlib import Path

from ..shared import EngineError, files, lock, projects, run_files, text

WORK, STATE = "reconstruction", "state.json"
"""The engine's own folder, and its record in it."""
REPORT = "reconstruction.md"
"""Beside that folder."""


@dataclass(frozen=True, kw_only=True)
class ReconstructionStatus:
    """The state of a reconstruction's folder at one moment.

    Attributes:
        done: whether the model exists.
        unfinished: whether a reconstruction was started and has not been finished.
        summary: the report's first sentence; empty without a report.
        remarks: the report's further remarks on all photos, one sentence each.
        holder: process of an engine that works there now; 0 if there is none.
    """

    done: bool = False
    unfinished: bool = False
    summary: str = ""
    remarks: tuple[str, ...] = ()
    holder: int = 0


def read(folder: Path) -> ReconstructionStatus:
    """Read the state of a folder; a missing or unreadable folder counts as empty."""
    work = folder / WORK
    try:
        state = files.read_json(work / STATE)
    except EngineError:
        state = None
    begun = isinstance(state, dict)
    model = folder / projects.SPARSE / "0"
    done = begun and bool(state.get("done")) and projects.model_suffix(model) is not None
    held = work / run_files.LOCK
    holder = lock.holder(held)
    killed = os.path.lexists(held) and not holder
    summary, remarks = _told(folder / REPORT)
    return ReconstructionStatus(
        done=done,
        unfinished=begun and (killed or not done) and not holder,
        summary=summary,
        remarks=remarks,
        holder=holder,
    )


def is_free(folder: Path) -> bool:
    """Whether a folder is missing or empty, or has a reconstruction."""
    try:
        return (folder / WORK).is_dir() or not next(iter(os.scandir(folder)), None)
    except FileNotFoundError:
        return True
    except OSError:
        return False


def _told(report: Path) -> tuple[str, tuple[str, ...]]:
    """Return the report's summary and remarks, which come before its first table."""
    try:
        lines = files.read_bytes(report).decode("utf-8", "replace").splitlines()
    except OSError:
        return "", ()
    head = list(itertools.takewhile(lambda line: not line.startswith("|"), lines))
    said = [text.plain_text(line) for line in head if line and not line.startswith("#")]
    remarks = tuple(line[2:] for line in said if line.startswith("- "))
    return next((line for line in said if not line.startswith("- ")), ""), remarks
