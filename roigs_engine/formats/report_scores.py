"""Reads scores from a run's `report.json`, which another program may have written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .files import read_record
from .run_files import REPORT_DATA

LARGEST = 1e15
"""Limit of scores, so that their text stays short."""


def scores_of_result(run: Path) -> dict[str, dict[str, float]]:
    """Read the scores of the run's model (a box's last row): box -> name -> finite number.

    Damaged entries are skipped.
    """
    boxes = read_record(run / REPORT_DATA).get("rois")
    found: dict[str, dict[str, float]] = {}
    for box in boxes if isinstance(boxes, list) else ():
        rows = box.get("rows") if isinstance(box, dict) else None
        row = rows[-1] if isinstance(rows, list) and rows else None
        if isinstance(row, dict) and isinstance(box.get("roi"), str):
            found[box["roi"]] = {k: value for k, value in row.items() if _is_number(value)}
    return found


def _is_number(value: Any) -> bool:
    """Whether it is a finite number; JSON has integers that no float can hold."""
    return type(value) in (int, float) and abs(value) < LARGEST
