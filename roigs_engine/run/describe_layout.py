"""Blocks of the scene and groups of boxes as text."""

from __future__ import annotations

from ..context import QUIET, Context
from ..formats.text import counted, in_gb
from .definition import Run
from .layout import Cell
from .memory import cell_memory


def describe_layout(run: Run, context: Context = QUIET) -> list[str]:
    """A line for each block and each group; none if there is one block and one box."""
    layout, lines = run.layout, []
    if layout.blocks:
        plans = cell_memory(run.scene, layout, run.config, context.photo_memory)
        lines = [
            f"{_line(cell)}, {counted(len(cell.points), 'point')}, {in_gb(plan.total)}"
            for cell, plan in zip(layout.blocks.cells, plans, strict=False)
        ]
    if layout.cells:
        return lines + [_line(cell) for cell in layout.cells.cells if "group" in cell.label]
    if len(run.rois) > 1 and run.config.strategy == "joint":
        lines.append(f"Boxes trained together: {', '.join(layout.groups[0])}")
    return lines


def _line(cell: Cell) -> str:
    """For example `Block 2: vase, tin; 73 photos`."""
    boxes = ", ".join(roi.name for roi in cell.rois) or "no box"
    name = cell.label.replace("-", " ").capitalize()
    return f"{name}: {boxes}; {counted(len(cell.photos), 'photo')}"
