"""The manifest of a run folder: it keeps results of different runs from being mixed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import own_folder, read_json, write_json
from ..formats.run_files import MANIFEST, PROVENANCE, SPLIT
from ..formats.text import json_digest
from .archive import archive_parts, restore_parts
from .config import STRATEGIES
from .definition import MANIFEST_VERSION
from .renaming import rename_results, rename_stages, renamed_boxes, with_names

FORMER_NAME = "request.json"  # until 0.1.0
CONTENTS, MASKS = "contents", "masks"  # the keys of the digests of photos and of their masks
OBJECTS = "object_masks"  # the key of the digests of the masks of boxes' objects
FIRST = ("sizes", CONTENTS)  # say more than what follows from them
OTHER_SCENE = "its photos are those of another scene"
MECHANISMS = ".mechanisms."  # of a stage, by name
MOST_TEXT = 120  # characters; a longer difference is not spelled out
# Results of the run as a whole, not of one stage.
RESULTS = (
    *(run_files.RESULT, run_files.BACKGROUND, run_files.FINE, run_files.COARSE),
    *(
        run_files.REPORT,
        run_files.REPORT_DATA,
        run_files.REPORT_PAGE,
        run_files.CROPS,
        run_files.LEVELS,
        run_files.LEVELS_FILE,
        run_files.SELECTION,
    ),
    run_files.SETTINGS,
)


def claim(
    folder: Path, manifest: dict[str, Any], *, update: bool, context: Context = QUIET
) -> None:
    """Write the manifest to `folder`, or check that it equals the folder's manifest.

    With `update`, the results of another manifest are archived, and archived results of this one
    are restored. Boxes may have other names: their stages and results are renamed.

    Raises:
        RunFolderError: the folder was made for other settings, or by an earlier version.
    """
    path, now = folder / MANIFEST, from_json(manifest)
    check_version(folder)
    if not path.exists():
        write_json(path, now)
    elif difference := manifest_difference(before := read_manifest(path), now):
        if not update:
            raise _other_run(folder, difference)
        _change(folder, before, now, context)
    # Also if nothing changed: an engine may have been killed before all results were back.
    restored = json_digest(read_manifest(path))
    for home in _homes(folder):
        restore_parts(home, RESULTS, restored)


def _homes(folder: Path) -> tuple[Path, ...]:
    """The run folder, and those of the strategies that it is compared with."""
    return (folder, *(own_folder(folder, run_files.COMPARED + name) for name in STRATEGIES))


def _change(folder: Path, before: Any, now: dict[str, Any], context: Context) -> None:
    """Archive the results of `before`, rename boxes, and write the manifest `now`.

    An engine may be killed at any moment, and the next one goes on. So results of `before` are
    archived while the manifest still says whose they are, and each step may be done twice.
    """
    renamed = renamed_boxes(before, now)
    other = manifest_difference(with_names(before, renamed), now)
    homes = _homes(folder)
    if other:
        for home in homes:
            archive_parts(home, RESULTS, json_digest(before))
    for old, new in renamed.items():
        for home in homes:
            rename_stages(home, old, new)
            if not other:
                rename_results(home, old, new)
        # One name at a time: where `a` becomes `b` and `b` becomes `c`, files called `b` do not
        # tell which of the two they belong to.
        before = with_names(before, {old: new})
        write_json(folder / MANIFEST, before)
        context.info(f"Box '{old}' is now called '{new}'; its training is kept.")
    write_json(folder / MANIFEST, now)
    if other:
        context.info(f"Updated {folder} to the new settings ({other}).")


def refuse_other_run(folder: Path, manifest: dict[str, Any]) -> None:
    """Raise RunFolderError if the folder has a run of other settings or boxes, or another scene.

    As `claim`, before the photos are looked at: without what depends on which of them are damaged.
    """
    path, now = folder / MANIFEST, from_json(manifest)
    if path.exists():
        before = read_manifest(path)
        if isinstance(before, dict):
            difference = manifest_difference(_without_contents(before), _without_contents(now))
            if _other_scene(before, now):
                difference = OTHER_SCENE
            if difference:
                raise _other_run(folder, difference)


def _without_contents(manifest: dict[str, Any]) -> dict[str, Any]:
    """What does not depend on the photos' pixels: a damaged one changes the others' use, too."""
    return {key: manifest.get(key) for key in ("config", "rois")}


def _other_run(folder: Path, difference: str) -> RunFolderError:
    return RunFolderError(
        f"{folder} has another run ({difference}).",
        "Add --update to archive that run, or choose another run folder (--run-dir).",
    )


def read_manifest(path: Path) -> Any:
    """The manifest of a run folder; RunFolderError if it cannot be read."""
    try:
        return read_json(path)
    except RunFolderError as error:
        hint = "Delete it; finished stages that still fit are kept."
        raise RunFolderError(error.message, hint) from error


def check_version(folder: Path) -> None:
    """Raise RunFolderError if another version of the engine made the folder, or somebody else."""
    refuse_foreign_files(folder)
    path = folder / MANIFEST
    record = read_manifest(path) if path.exists() else None
    version = MANIFEST_VERSION
    if isinstance(record, dict) and "config" in record:
        version = record.get("version", 0)
    if version != MANIFEST_VERSION or (record is None and (folder / FORMER_NAME).exists()):
        newer = isinstance(version, int) and version > MANIFEST_VERSION
        raise RunFolderError(
            f"{folder} was made by {'a later' if newer else 'an earlier'} version; this version"
            " cannot resume it.",
            "Choose another run folder (--run-dir); the results in this one stay as they are.",
        )


def refuse_foreign_files(folder: Path) -> None:
    """Raise RunFolderError if a run would replace files that are not a run's."""
    if any((folder / name).exists() for name in (MANIFEST, SPLIT, PROVENANCE)):
        return  # without a manifest, the results of a run are verified and kept
    found = next((name for name in RESULTS if (folder / name).exists()), None)
    if found is not None:
        raise RunFolderError(
            f"{folder} is not a run folder, and a run would replace {folder / found}.",
            "Move away what is there, or choose another run folder (--run-dir).",
        )


def from_json(value: Any) -> Any:
    """The value after a round trip through JSON, which turns tuples into lists."""
    return json.loads(json.dumps(value))


def manifest_difference(before: Any, now: Any, path: str = "") -> str:
    """The first difference of two manifests, or of parts of them, as text; empty: they are equal.

    Args:
        before, now: JSON values.
        path: the keys that lead to these parts.
    """
    if path == CONTENTS and isinstance(before, dict) and isinstance(now, dict):
        return _photos_changed(before, now)
    if path == MASKS:
        return _masks_changed(before or {}, now or {})
    if path == OBJECTS:
        return _objects_changed(before or {}, now or {})
    if isinstance(before, dict) and isinstance(now, dict):
        if not path and _other_scene(before, now):
            return OTHER_SCENE
        keys = [*before, *(k for k in now if k not in before)]
        for key in sorted(keys, key=lambda key: key not in FIRST):
            found = manifest_difference(
                before.get(key), now.get(key), f"{path}.{key}" if path else key
            )
            if found:
                return found
        return ""
    if before == now:
        return ""
    name = path.removeprefix("config.").removeprefix("selection.")
    name = name.replace("manual", "--selection", 1) if name.startswith("manual") else name
    if name == "sizes" and isinstance(before, list) and isinstance(now, list):
        sizes = (", ".join(map(str, value)) for value in (before, now))
        return "the photos' size was {}, now {} (--max-side, --downscale)".format(*sizes)
    if name == "groups":
        before, now = (_groups_in_words(value) for value in (before, now))
    if name == "blocks":
        before, now = before or 1, now or 1
    if name.endswith(".antialiased"):
        words = ("on" if value else "off" for value in (before, now))
        return "anti-aliasing was {}, now {} (--antialiased, --no-antialiased)".format(*words)
    name = name.replace(MECHANISMS, ".", 1)
    if MECHANISMS in path and None in (before, now):
        words = ("off" if value is None else "on" for value in (before, now))
        return "{} was {}, now {}".format(name, *words)
    text = f"{name} was {before}, now {now}"
    return text if len(text) <= MOST_TEXT else f"{name} changed"


def _groups_in_words(groups: list[list[str]] | None) -> str:
    """Groups of boxes, as `--group` takes them."""
    return " and ".join(",".join(group) for group in groups) if groups else "all boxes"


def _other_scene(before: dict[str, Any], now: dict[str, Any]) -> bool:
    """Whether two manifests have no photo in common."""
    old, new = before.get(CONTENTS), now.get(CONTENTS)
    if not (isinstance(old, dict) and isinstance(new, dict) and old and new):
        return False
    return not old.keys() & new.keys()


def _photos_changed(before: dict[str, Any], now: dict[str, Any]) -> str:
    """Which photos changed, in words; empty if none."""
    names = [
        name for name in sorted(before.keys() | now.keys()) if before.get(name) != now.get(name)
    ]
    if not names:
        return ""
    first = names[0]
    lost, new = (set(names) - side.keys() for side in (now, before))
    if len(names) == 1:
        return f"the photo {first} {'is missing' if lost else 'is new' if new else 'changed'}"
    how = "are missing" if len(lost) == len(names) else "are new" if len(new) == len(names) else ""
    return f"{len(names)} photos {how or 'changed'}, the first is {first}"


def _masks_changed(before: dict[str, Any], now: dict[str, Any]) -> str:
    """How many photos have another mask, in words; empty if none."""
    names = [n for n in sorted(before.keys() | now.keys()) if before.get(n) != now.get(n)]
    if not names:
        return ""
    if len(names) == 1:
        return f"the mask of {names[0]} changed"
    return f"the masks of {len(names)} photos changed, the first is {names[0]}"


def _objects_changed(before: dict[str, Any], now: dict[str, Any]) -> str:
    """Which box has other masks of its object, in words; empty if none."""
    for box in sorted(before.keys() | now.keys()):
        changed = _masks_changed(before.get(box, {}), now.get(box, {}))
        if changed:
            return f"box '{box}': {changed}"
    return ""
