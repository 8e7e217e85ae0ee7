"""The manifest of a run folder, which keeps results of different runs apart."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..colmap import exposures
from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.clean_up import is_run_folder
from ..formats.files import read_json, read_record, write_json
from ..formats.others import first_other, is_other
from ..formats.run_files import (
    CACHE,
    CLUSTER_OPTIONS,
    EVENTS,
    EXPOSURES,
    MANIFEST,
    PREVIEW,
    PROVENANCE,
    RESULTS,
    SPLIT,
)
from ..formats.text import json_digest
from ..photos import contents
from .definition import MANIFEST_VERSION
from .earlier import bring_back, set_aside

CONTENTS = "contents"  # key of the photos' digests
CACHED = {
    f"{CACHE}/{contents.FILE}": contents.KEYS,
    f"{CACHE}/{EXPOSURES}": exposures.KEYS,
}
"""Files in a run folder with stored facts on photos -> their keys."""
FIRST = ("sizes", CONTENTS)  # compared first: these may cause other differences
LEFT_OUT = ("config", "selection", "mechanisms")  # keys omitted from a setting's path in messages
OTHER_SCENE = "its photos are those of another scene"
MOST_TEXT = 120  # characters; a longer text only says that the setting changed


def claim(
    folder: Path, manifest: dict[str, Any], *, update: bool, context: Context = QUIET
) -> None:
    """Write the manifest to `folder`, or check that it equals the folder's manifest.

    With `update`, the results of another manifest move to `earlier/`, and those of this one move
    back from there. An engine may be killed at any moment. So results move while the manifest still
    identifies them, and the next engine can continue.

    Raises:
        RunFolderError: the folder was made for other settings, or by another version.
    """
    path, now = folder / MANIFEST, from_json(manifest)
    check_version(folder)
    is_new = not path.exists()
    before = now if is_new else read_manifest(path)
    if difference := manifest_difference(before, now):
        if not update:
            raise _other_run(folder, difference)
        set_aside(folder, json_digest(before))
        context.info(f"Updated {folder} to the new settings ({difference}).")
    if is_new or difference:
        write_json(path, now)
    bring_back(folder, json_digest(now))


def refuse_other_run(folder: Path, manifest: dict[str, Any]) -> None:
    """Raise RunFolderError if the folder has a run of other settings or boxes, or another scene.

    This is the check of `claim` before the photos are read. It leaves out all that depends on which
    photos are damaged.
    """
    path, now = folder / MANIFEST, from_json(manifest)
    before = read_manifest(path) if path.exists() else None
    if isinstance(before, dict):
        difference = manifest_difference(_without_contents(before), _without_contents(now))
        if _is_other_scene(before, now):
            difference = OTHER_SCENE
        if difference:
            raise _other_run(folder, difference)


def _without_contents(manifest: dict[str, Any]) -> dict[str, Any]:
    """The parts that do not depend on photos: a damaged photo also changes the others' use."""
    return {key: manifest.get(key) for key in ("config", "rois")}


def _other_run(folder: Path, difference: str) -> RunFolderError:
    return RunFolderError(
        f"{folder} has another run ({difference}).",
        "Add --update to move its results to 'earlier' there, or choose another run folder"
        " (--run-dir).",
    )


def read_manifest(path: Path) -> Any:
    """Read the manifest of a run folder; RunFolderError if it is unreadable or no manifest."""
    hint = "Delete it; valid finished stages are kept."
    record = read_json(path, hint=hint)
    if not isinstance(record, dict):
        raise RunFolderError(f"{path} is not a manifest of a run.", hint)
    return record


def check_version(folder: Path) -> None:
    """Raise RunFolderError if another version, or another program, made the folder."""
    refuse_foreign_files(folder)
    path = folder / MANIFEST
    record = read_manifest(path) if path.exists() else None
    if record is None:
        return
    if not {"config", "version"} & record.keys():
        hint = "Choose another run folder (--run-dir), or move that file away."
        raise RunFolderError(f"{path} is not a manifest of a run.", hint)
    if record.get("version") != MANIFEST_VERSION:
        raise RunFolderError(
            f"{folder} was made by another version; this version cannot resume it.",
            "Choose another run folder (--run-dir); the results in this one stay as they are.",
        )


def refuse_foreign_files(folder: Path) -> None:
    """Raise RunFolderError if a run would replace files that are not a run's."""
    if (folder / MANIFEST).exists() or is_run_folder(folder):
        return
    if {"evaluate_on", "test"} <= read_record(folder / SPLIT).keys():
        return  # a run folder without manifest; its results are verified and kept
    names = (*RESULTS, PREVIEW, PROVENANCE)
    there = next((folder / name for name in names if (folder / name).exists()), None)
    # An engine killed at its start leaves only these.
    found = there or first_other(folder, {**CACHED, CLUSTER_OPTIONS: ("scene",)})
    if found is None and is_other(folder / EVENTS, ("event",), lines=True):
        found = folder / EVENTS
    if found is not None:
        raise RunFolderError(
            f"{folder} is not a run folder, and a run would replace {found}.",
            "Move its files away, or choose another run folder (--run-dir).",
        )


def from_json(value: Any) -> Any:
    """The value after a round trip through JSON, which turns tuples into lists."""
    return json.loads(json.dumps(value))


# --- differences in words ---


def manifest_difference(before: Any, now: dict[str, Any]) -> str:
    """The first difference of two manifests, as text; empty: they are equal.

    `now` is a manifest as JSON, `before` any value from a file.
    """
    old = before if isinstance(before, dict) else {}
    if _is_other_scene(old, now):
        return OTHER_SCENE
    for key in sorted({**old, **now}, key=lambda key: key not in FIRST):
        if old.get(key) != now.get(key):
            try:
                text = _WORDS.get(key, _setting)(key, old.get(key), now.get(key))
            except Exception:  # `before` is malformed
                text = f"{key} changed"
            if text:
                return text
    return ""


def _setting(path: str, before: Any, now: Any) -> str:
    """The first difference of two settings, or of dicts of them, at a path of keys.

    Empty if there is none: a missing setting equals null.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        changed = (key for key in {**before, **now} if before.get(key) != now.get(key))
        texts = (_setting(f"{path}.{key}", before.get(key), now.get(key)) for key in changed)
        return next(filter(None, texts), "")
    name = ".".join(key for key in path.split(".") if key not in LEFT_OUT) or path
    if isinstance(before, dict) or isinstance(now, dict):
        was, now_is = ("on" if value or value == {} else "off" for value in (before, now))
        return f"{name} was {was}, now {now_is}"
    if path.endswith(".made_for"):
        return f"it was made for {before}, now {now} (--made-for)"
    before, now = ("unset" if value is None else value for value in (before, now))
    text = f"{name} was {before}, now {now}"
    return text if len(text) <= MOST_TEXT else f"{name} changed"


def _sizes(_: str, before: Any, now: Any) -> str:
    was, are = (", ".join(map(str, value or ())) for value in (before, now))
    return f"the photos' size was {was}, now {are} (--max-side, --downscale)"


def _exposures(_: str, before: Any, now: Any) -> str:
    if before and now:
        return "the photos' exposures changed"
    was, are = ("" if value else "not " for value in (before, now))
    return f"photos were {was}levelled, now they are {are}levelled (--no-exposures)"


def _groups(_: str, before: Any, now: Any) -> str:
    """A difference of groups of boxes, written as for `--group`."""
    was, are = (
        " and ".join(",".join(group) for group in groups or ()) or "all boxes"
        for groups in (before, now)
    )
    return f"groups was {was}, now {are}"


def _rois(_: str, before: Any, now: Any) -> str:
    old, new = ({roi.get("name"): roi for roi in rois or ()} for rois in (before, now))
    return _changed("box", "boxes", old, new) if old != new else "the order of the boxes changed"


def _changed(one: str, many: str, old: dict[str, Any], new: dict[str, Any]) -> str:
    """The differences between two sets of named values."""
    names = _different(old, new)
    lost, added = (not set(names) & side.keys() for side in (new, old))
    if len(names) == 1:
        return f"the {one} {names[0]} {'is gone' if lost else 'is new' if added else 'changed'}"
    how = "are gone" if lost else "are new" if added else "changed"
    return f"{len(names):,} {many} {how}, the first is {names[0]}"


def _masks(_: str, before: Any, now: Any) -> str:
    return _changed("mask of", "masks", _by_name(before), _by_name(now))


def _object_masks(_: str, before: Any, now: Any) -> str:
    old, new = _by_name(before), _by_name(now)
    box = _different(old, new)[0]
    return f"box '{box}': {_masks('', old.get(box), new.get(box))}"


_WORDS: Mapping[str, Callable[[str, Any, Any], str]] = {
    "sizes": _sizes,
    "exposures": _exposures,
    "rois": _rois,
    "groups": _groups,
    CONTENTS: lambda _, old, new: _changed("photo", "photos", _by_name(old), _by_name(new)),
    "masks": _masks,
    "object_masks": _object_masks,
    "manual": lambda _, old, new: _setting("--selection", _by_name(old), _by_name(new)),
}


def _by_name(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _different(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Keys with different values, sorted."""
    return [name for name in sorted(before | now) if before.get(name) != now.get(name)]


def _is_other_scene(before: dict[str, Any], now: dict[str, Any]) -> bool:
    """Whether two manifests have photos, but none in common."""
    old, new = _by_name(before.get(CONTENTS)), _by_name(now.get(CONTENTS))
    return bool(old and new) and not old.keys() & new.keys()
