"""What a run folder was made for, so that nothing of another run is mixed in or overwritten."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.files import read_json, write_json
from .archive import archive_parts, restore_parts

NAME = "manifest.json"
FORMER_NAME = "request.json"  # until 0.1.0
# What follows from a manifest as a whole, and not from one stage.
RESULTS = (
    *("result.ply", "background.ply", "rois", "coarse"),
    *("report.md", "report.json", "crops", "selection"),
)


def claim(
    folder: Path, manifest: dict[str, Any], *, update: bool, context: Context = QUIET
) -> None:
    """Write the manifest to `folder`, or check that it is the one the folder was made for.

    With `update`, the results of another manifest are archived, and those of this one restored.

    Raises:
        RunFolderError: the folder was made for other settings, or by an earlier version.
    """
    path, now = folder / NAME, from_json(manifest)
    check_version(folder)
    if not path.exists():
        write_json(path, now)
        return
    before = read_json(path)
    difference = manifest_difference(before, now)
    if not difference:
        return
    if not update:
        raise RunFolderError(
            f"{folder} holds another run ({difference}).",
            "Add --update to bring it up to date, or choose another --run-dir.",
        )
    archive_parts(folder, RESULTS, manifest_digest(before))
    restore_parts(folder, RESULTS, manifest_digest(now))
    write_json(path, now)
    context.info(f"{folder} is brought up to date ({difference}).")


def check_version(folder: Path) -> None:
    """Raise RunFolderError if an earlier version of the engine made the folder."""
    if (folder / FORMER_NAME).exists() and not (folder / NAME).exists():
        raise RunFolderError(
            f"{folder} was made by an earlier version, whose runs cannot be resumed.",
            "Choose another --run-dir; the results in this one stay as they are.",
        )


def from_json(value: Any) -> Any:
    """The value as it comes back from JSON, which has no tuples."""
    return json.loads(json.dumps(value))


def manifest_digest(manifest: Any) -> str:
    """Hash of a manifest as it comes back from JSON."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def manifest_difference(before: Any, now: Any, path: str = "") -> str:
    """The first place where two JSON values differ, in words; empty when they agree."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(k for k in now if k not in before)]:
            found = manifest_difference(
                before.get(key), now.get(key), f"{path}.{key}" if path else key
            )
            if found:
                return found
        return ""
    return "" if before == now else f"{path} was {before}, now {now}"
