"""A camera selection as text."""

from __future__ import annotations

from ..formats.text import counted, printable
from .records import CameraSelection


def format_selection(selection: CameraSelection) -> str:
    """A summary line, a table of the selected photos, best first, and the warnings."""
    head = ("rank", "photo", "score", "distance", "area", "keypoints")
    rows = [head]
    for rank, (name, score) in enumerate(
        zip(selection.names, selection.scores, strict=True), start=1
    ):
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
