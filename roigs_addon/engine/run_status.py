"""Reads the state of a training from its run folder (docs/files.md, Run folder). No bpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..shared import EngineError, files, lock, run_files, stage_list
from . import run_settings
from .run_settings import RunSettings

TrainedBox = tuple[Any, Any]
"""world_to_box and half_extents, as in the file."""


@dataclass(frozen=True, kw_only=True)
class RunStatus:
    """The state of a run folder at one moment.

    Attributes:
        done: finished stages, in the order of their training.
        seconds: training time of each finished stage; 0 if unknown.
        left: a stage that was stopped midway; empty if there is none.
        result: whether the result exists.
        boxes: the trained boxes by name; None if unknown.
        settings: of the training.
        lists: box -> its training photos that the user chose.
        photos: names of the training photos; None if unknown.
        holder: process of an engine that works there now; 0 if there is none.
    """

    done: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    left: str = ""
    result: bool = False
    boxes: dict[str, TrainedBox] | None = None
    settings: RunSettings = field(default_factory=RunSettings)
    lists: Mapping[str, list[str]] = field(default_factory=dict)
    photos: frozenset[str] | None = None
    holder: int = 0

    @property
    def unfinished(self) -> bool:
        """Whether a training was started and has not been finished."""
        return bool(self.left or (self.done and not self.result))


def read(folder: Path) -> RunStatus:
    """Read the state of a folder; a missing or unreadable folder counts as an empty run."""
    try:
        return _read(folder)
    except OSError:
        return RunStatus()


def _read(folder: Path) -> RunStatus:
    places = stage_list.read_stage_list(folder)
    records = {name: place / run_files.STAGE for name, place in places.items()}
    done = sorted(
        (name for name in records if records[name].is_file()), key=lambda n: _age(records[n])
    )
    left = [name for name, place in places.items() if files.matching(place, "checkpoint*.bin")]
    manifest = _object(folder / run_files.MANIFEST)
    return RunStatus(
        done=tuple(done),
        seconds={name: _seconds(records[name]) for name in done},
        left=left[0] if left else "",
        result=(folder / run_files.RESULT).is_file(),
        boxes=_boxes(manifest),
        settings=run_settings.read(folder, _dict(manifest.get("config"))),
        lists={k: v for k, v in _dict(manifest.get("manual")).items() if isinstance(v, list)},
        photos=_photos(manifest, _object(folder / run_files.SPLIT)),
        holder=lock.holder(folder / run_files.LOCK),
    )


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _seconds(stage: Path) -> float:
    seconds = _object(stage).get("seconds")
    return float(seconds) if isinstance(seconds, (int, float)) else 0.0


def _object(path: Path) -> dict[str, Any]:
    """Read the object in a JSON file; empty if there is none."""
    try:
        return _dict(files.read_json(path))
    except EngineError:
        return {}


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _boxes(manifest: dict[str, Any]) -> dict[str, TrainedBox] | None:
    try:
        records = manifest["rois"]
        return {str(r["name"]): (r["world_to_box"], r["half_extents"]) for r in records}
    except (KeyError, TypeError):
        return None


def _photos(manifest: dict[str, Any], split: dict[str, Any]) -> frozenset[str] | None:
    """Return the manifest's photos without test and validation photos."""
    names = set(_dict(manifest.get("contents")))
    held_out = [split.get(key) for key in ("test", "validation")]
    for listed in held_out:
        names -= {str(name) for name in listed} if isinstance(listed, list) else set()
    return frozenset(names) or None
