"""The result of a selection, and its text."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ..formats.text import counted, printable


@dataclass(frozen=True, kw_only=True)
class CameraSelection:
    """The selected photos of one box.

    Attributes:
        roi: the box's name.
        method: one of `METHODS`, or `manual`.
        names: selected photos, best first.
        scores: the score after each photo, 0 to 1: for `coverage`, F as a share of F(all
            candidates); otherwise density x occupancy of the points in the box.
        candidates: every photo that sees the box, in name order.
        flags: warnings about degenerate cases.
        features: candidate -> 'distance' (world units, to the box's centre), 'area' (share of the
            image that the box covers), 'keypoints' (points in the box that the photo sees).
    """

    roi: str
    method: str
    names: tuple[str, ...]
    scores: tuple[float, ...]
    candidates: tuple[str, ...]
    flags: tuple[str, ...] = ()
    features: dict[str, dict[str, float]] = field(default_factory=dict)

    def in_units(self, unit: float) -> CameraSelection:
        """The selection with its distances divided by `unit`."""
        features = {
            name: {**values, "distance": values["distance"] / unit}
            for name, values in self.features.items()
        }
        return replace(self, features=features)

    def to_dict(self) -> dict[str, Any]:
        """The selection as JSON values."""
        record = asdict(self)
        return {key: list(v) if isinstance(v, tuple) else v for key, v in record.items()}


def format_selection(selection: CameraSelection) -> str:
    """A summary line, a table of the selected photos, best first, and the warnings."""
    head = ("rank", "photo", "score", "distance", "area", "keypoints")
    rows = [head]
    pairs = zip(selection.names, selection.scores, strict=True)
    for rank, (name, score) in enumerate(pairs, start=1):
        values = selection.features.get(name, {})
        rows.append(
            (
                str(rank),
                printable(name),
                f"{score:.4f}",
                f"{values['distance']:.4g}" if "distance" in values else "-",
                f"{100 * values['area']:.1f} %" if "area" in values else "-",
                f"{values['keypoints']:.0f}" if "keypoints" in values else "-",
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    lines = [
        f"Box '{selection.roi}': {counted(len(selection.names), 'photo')} selected by"
        f" {selection.method}, of {counted(len(selection.candidates), 'candidate')}"
    ]
    for row in rows:
        cells = [
            cell.ljust(width) if column == 1 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    lines += [printable(f"! {flag}") for flag in selection.flags]
    return "\n".join(lines)
