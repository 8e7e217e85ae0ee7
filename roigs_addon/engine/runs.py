"""What a run folder says of itself (docs/files.md, «Run folder»). No bpy."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LOCKED_BYTE = 1 << 30


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run folder at one moment.

    Attributes:
        done: stages that are trained, in the order in which they were.
        left: the stage that was left in the middle; empty when there is none.
        result: whether the result is there.
        boxes: what was trained for: name -> (world_to_box, half_extents).
        holder: process of an engine that works there now; 0 for none.
    """

    done: tuple[str, ...] = ()
    left: str = ""
    result: bool = False
    boxes: dict[str, tuple[Any, Any]] | None = None
    holder: int = 0

    @property
    def begun(self) -> bool:
        """Whether a training was begun and did not come to its end."""
        return bool(self.left or (self.done and not self.result))


def read(folder: Path) -> Run:
    """Look; a folder that is not there, or cannot be looked into, is an empty run."""
    try:
        return _read(folder)
    except OSError:
        return Run()


def _read(folder: Path) -> Run:
    stages = sorted(folder.glob("*/stage.json"), key=_age)
    left = [path.parent.name for path in folder.glob("*/checkpoint*.bin")]
    return Run(
        done=tuple(path.parent.name for path in stages),
        left=left[0] if left else "",
        result=(folder / "result.ply").is_file(),
        boxes=_boxes(folder / "request.json"),
        holder=_holder(folder / "run.lock"),
    )


def stage_in_words(stage: str) -> str:
    """«whole scene» for «scene»."""
    words = {
        "scene": "whole scene",
        "joint": "all boxes",
        "seam": "seams",
        "undistort": "undistorting photos",
    }
    if stage.startswith("object-"):
        return f"box «{stage.removeprefix('object-')}»"
    return words.get(stage, stage)


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _boxes(request: Path) -> dict[str, tuple[Any, Any]] | None:
    try:
        records = json.loads(request.read_text(encoding="utf-8"))["rois"]
        return {str(r["name"]): (r["world_to_box"], r["half_extents"]) for r in records}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _holder(path: Path) -> int:
    """The process that holds the lock; a file that nobody locks was left by one that was killed."""
    try:
        with open(path, "r+b") as file:
            if not _locked(file.fileno()):
                return 0
        return int(json.loads(path.read_text(encoding="utf-8"))["pid"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return 0


def _locked(descriptor: int) -> bool:
    """Whether another process has it. A lock that can be had is given back at once."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return True
        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False
