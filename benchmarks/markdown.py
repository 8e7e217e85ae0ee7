"""Tables in Markdown, for every benchmark."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

NONE = "-"
"""Text of an empty cell."""


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, names: int | None = None
) -> list[str]:
    """The lines of a table.

    Args:
        head: headings.
        rows: cells; an empty one becomes a dash.
        names: number of text columns; the others are numbers, aligned to the right. None: all
            columns are text.
    """
    left = len(head) if names is None else names
    rule = ["---"] * left + ["---:"] * (len(head) - left)
    return [_line(cells) for cells in (head, rule, *rows)]


def _line(cells: Sequence[str]) -> str:
    escaped = (cell.replace("|", "\\|") if cell else NONE for cell in cells)
    return f"| {' | '.join(escaped)} |"
