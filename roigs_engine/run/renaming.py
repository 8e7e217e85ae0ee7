"""Boxes with another name than before: their files follow, and nothing is trained again.

A box is the same one if its place and size are exactly the same.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import matching, own_folder, read_json, write_json
from ..formats.text import json_digest
from .archive import move

STAGES = (
    *(run_files.OBJECT_STAGE, run_files.FULL_OBJECT_STAGE),
    *(run_files.TUNED_STAGE + run_files.OBJECT_STAGE,),
    *(run_files.TUNED_COARSE_STAGE + run_files.OBJECT_STAGE,),
)
RESULTS = (
    *(f"{run_files.FINE}/{{}}.ply", f"{run_files.COARSE}/{{}}.ply"),
    *(f"{run_files.SELECTION}/{{}}.json", f"{run_files.CROPS}/{{}}"),
)
ARCHIVED = re.compile(r"-([0-9a-f]{8}|damaged)(-\d+)?")
"""What follows a stage's name in the archive."""


def renamed_boxes(before: Any, now: dict[str, Any]) -> dict[str, str]:
    """Old name -> new one, of the boxes of two manifests, in an order that never meets a file.

    Boxes that have swapped their names are left out.
    """
    old, new = _by_place(before), _by_place(now)
    left = {old[place]: new[place] for place in old if place in new and old[place] != new[place]}
    ordered: dict[str, str] = {}
    while free := [name for name, other in left.items() if other not in left]:
        ordered |= {name: left.pop(name) for name in free}
    return ordered


def with_names(manifest: dict[str, Any], renamed: dict[str, str]) -> dict[str, Any]:
    """A manifest with the new names."""
    if not renamed:
        return manifest
    named = dict(manifest)
    named["rois"] = [
        roi | {"name": renamed.get(str(roi.get("name")), roi.get("name"))}
        for roi in manifest["rois"]
        if isinstance(roi, dict)
    ]
    for key in ("manual", "object_masks"):
        if isinstance(by_box := manifest.get(key), dict):
            named[key] = {renamed.get(name, name): photos for name, photos in by_box.items()}
    if isinstance(groups := manifest.get("groups"), list):
        named["groups"] = [
            [renamed.get(name, name) for name in group] if isinstance(group, list) else group
            for group in groups
        ]
    return named


def rename_stages(home: Path, old: str, new: str) -> None:
    """Rename a box's stages in a run folder and in its archive.

    Raises:
        RunFolderError: one cannot be moved, or the archive is a link.
    """
    for prefix in STAGES:
        _rename(home / f"{prefix}{old}", home / f"{prefix}{new}")
        for place in own_folder(home, run_files.ARCHIVE).glob(f"{prefix}*"):
            mark = place.name.removeprefix(f"{prefix}{old}")
            if mark != place.name and ARCHIVED.fullmatch(mark):
                _rename(place, place.with_name(f"{prefix}{new}{mark}"))


def rename_results(home: Path, old: str, new: str) -> None:
    """Rename a box's results in a run folder; raises as `rename_stages`."""
    for form in RESULTS:
        _rename(home / form.format(old), home / form.format(new))
    _rename_levels(home, old, new)


def _rename_levels(home: Path, old: str, new: str) -> None:
    """Rename a box in the levels of detail; raises as `rename_stages`."""
    levels = own_folder(home, run_files.LEVELS)
    was, now = (f"{run_files.FINE}/{name}.ply" for name in (old, new))

    def renamed(record: Any) -> Any:
        if isinstance(record, list):
            return [renamed(value) for value in record]
        if isinstance(record, dict):
            named = {renamed(key): renamed(value) for key, value in record.items()}
            return named | {"box": new} if named.get("box") == old else named
        is_file = isinstance(record, str) and f"/{record}".endswith(f"/{was}")
        return record.removesuffix(was) + now if is_file else record

    for level in matching(levels, "*/"):
        folder = own_folder(levels, level.name, run_files.FINE)
        _rename(folder / f"{old}.ply", folder / f"{new}.ply")
    for path in (home / run_files.LEVELS_FILE, levels / run_files.LEVELS_MADE):
        with suppress(RunFolderError):  # there is none, or it is damaged and `levels` replaces it
            record = read_json(path)
            if renamed(record) != record:
                write_json(path, renamed(record))


def _rename(source: Path, target: Path) -> None:
    free = not target.exists() or (source.exists() and os.path.samefile(source, target))
    if source.exists() and free:  # a run that was killed in between has renamed it already
        move(source, target)


def _by_place(manifest: Any) -> dict[str, str]:
    """Place and size -> name, of the boxes that are alone there."""
    found: dict[str, list[str]] = {}
    for place, name in _boxes(manifest):
        found.setdefault(place, []).append(name)
    return {place: names[0] for place, names in found.items() if len(names) == 1}


def _boxes(manifest: Any) -> Iterator[tuple[str, str]]:
    """Place and size, and name, of each box of a manifest, which may be damaged."""
    records = manifest.get("rois") if isinstance(manifest, dict) else None
    for record in records if isinstance(records, list) else []:
        if isinstance(record, dict) and isinstance(record.get("name"), str):
            place = {key: value for key, value in record.items() if key != "name"}
            yield json_digest(place), record["name"]
