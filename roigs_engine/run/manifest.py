"""What a run folder was made for, so that nothing of another run is mixed in or overwritten."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ..context import Context
from ..errors import RunFolderError
from ..formats.files import read_json, write_json
from .archive import put_away_parts, take_back_parts

# What follows from a request as a whole, and not from one stage.
RESULTS = (
    *("result.ply", "surroundings.ply", "rois", "coarse"),
    *("report.md", "report.json", "crops", "selection"),
)


def claim(folder: Path, request: dict[str, Any], *, update: bool, context: Context) -> None:
    """Write the request to `folder`, or check that it is the one the folder was made for.

    With `update`, the results of another request make room for those of this one.

    Raises:
        RunFolderError: the folder was made for another request.
    """
    path = folder / "request.json"
    if not path.exists():
        write_json(path, request)
        return
    before = read_json(path)
    # JSON has no tuples: compare what would be read back.
    difference = _difference(before, _plain(request))
    if not difference:
        return
    if not update:
        raise RunFolderError(
            f"{folder} holds another run ({difference}).",
            "Add --update to bring it up to date, or choose another --run-dir.",
        )
    put_away_parts(folder, RESULTS, _digest(before))
    take_back_parts(folder, RESULTS, _digest(_plain(request)))
    write_json(path, request)
    context.info(f"{folder} is brought up to date ({difference}).")


def _digest(request: Any) -> str:
    """Hash of a request as it comes back from JSON."""
    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """The value as it comes back from JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _difference(before: Any, now: Any, path: str = "") -> str:
    """The first place where two JSON values differ, in words; empty when they agree."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(k for k in now if k not in before)]:
            found = _difference(before.get(key), now.get(key), f"{path}.{key}" if path else key)
            if found:
                return found
        return ""
    return "" if before == now else f"{path} was {before}, now {now}"
