"""Reads the exposures that training found for the photos. No bpy."""

from __future__ import annotations

from pathlib import Path

from ..shared import files, run_files

MOST = 32.0  # stops; no exposures differ by more


def read(folder: Path) -> dict[str, float]:
    """Photo -> stops above the usual exposure; empty if training levelled none.

    `folder`: a run folder.
    """
    stops = files.read_record(folder / run_files.CACHE / run_files.EXPOSURES).get("stops")
    if not isinstance(stops, dict):
        return {}
    known = {name: value for name, value in stops.items() if isinstance(value, (int, float))}
    return {name: float(value) for name, value in known.items() if abs(value) <= MOST}
