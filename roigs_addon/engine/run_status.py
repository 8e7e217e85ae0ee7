"""What a run folder says about its training (docs/files.md, section Run folder). No bpy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..shared import EngineError, files, lock, run_files

TrainedBox = tuple[Any, Any]
"""world_to_box and half_extents, as the file has them."""


@dataclass(frozen=True, kw_only=True)
class RunStatus:
    """A run folder at one moment.

    Attributes:
        done: finished stages, in the order in which they were trained.
        left: the stage that was stopped midway; empty if there is none.
        result: whether the result is there.
        boxes: what was trained for: name -> box; None if that is not known.
        holder: process of an engine that works there now; 0 if there is none.
    """

    done: tuple[str, ...] = ()
    left: str = ""
    result: bool = False
    boxes: dict[str, TrainedBox] | None = None
    holder: int = 0

    @property
    def unfinished(self) -> bool:
        """Whether a training was started and has not been finished."""
        return bool(self.left or (self.done and not self.result))


def read(folder: Path) -> RunStatus:
    """Look into a folder; one that is missing or unreadable counts as an empty run."""
    try:
        return _read(folder)
    except OSError:
        return RunStatus()


def _read(folder: Path) -> RunStatus:
    stages = sorted(folder.glob(f"*/{run_files.STAGE}"), key=_age)
    left = [path.parent.name for path in folder.glob("*/checkpoint*.bin")]
    return RunStatus(
        done=tuple(path.parent.name for path in stages),
        left=left[0] if left else "",
        result=(folder / run_files.RESULT).is_file(),
        boxes=_boxes(folder / run_files.MANIFEST),
        holder=lock.holder(folder / run_files.LOCK),
    )


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _boxes(manifest: Path) -> dict[str, TrainedBox] | None:
    try:
        records = files.read_json(manifest)["rois"]
        return {str(r["name"]): (r["world_to_box"], r["half_extents"]) for r in records}
    except (EngineError, KeyError, TypeError):
        return None
