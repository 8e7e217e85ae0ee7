"""Writes the report as a web page: one file, without network, with before-and-after sliders."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from ..formats.files import write_text
from ..formats.run_files import REPORT_PAGE
from ..formats.text import counted
from ..formats.web_page import html_text, whole_page
from .crops import Comparison, Shown
from .report import PHOTO_COLUMNS, Column, box_notes, cells, has_number, shown_columns
from .scores import Evaluation, ModelScore, RoiScores

SCRIPT = """\
for (const slider of document.querySelectorAll(".slider input")) {
  const move = () => slider.parentElement.style.setProperty("--at", slider.value + "%");
  slider.addEventListener("input", move);
  move();
}"""


def write_page(evaluation: Evaluation, pictures: Sequence[Comparison], run_dir: Path) -> Path:
    """Write `report.html`; return its path."""
    path = Path(run_dir) / REPORT_PAGE
    write_text(path, format_html(evaluation, pictures))
    return path


def format_html(evaluation: Evaluation, pictures: Sequence[Comparison]) -> str:
    """Format the page: for each box its tables, PSNR against seconds, sliders and notes."""
    title = f"Evaluation on {counted(len(evaluation.test_views), f'{evaluation.photos} photo')}"
    allowed = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    parts: list[str] = []
    for scores in evaluation.rois:
        of_box = [item for item in pictures if item.roi == scores.roi]
        parts += _box(scores, evaluation, of_box)
    parts.append(f"<script>{SCRIPT}</script>")
    return whole_page(title, parts, policy=f"; script-src 'sha256-{allowed}'")


def _box(scores: RoiScores, evaluation: Evaluation, pictures: Sequence[Comparison]) -> list[str]:
    rows = scores.rows
    parts = [f"<h2>{html_text(scores.roi)}</h2>", *_table(rows, shown_columns(rows))]
    if pictures:
        parts += ['<div class="pictures">', *(_figure(item) for item in pictures), "</div>"]
    parts += _plot(rows)
    columns = [column for column in PHOTO_COLUMNS if has_number(rows, column)]
    if columns:
        parts += ["<h3>Near and far, and single photos</h3>", *_table(rows, columns)]
    notes = (f"<li>{html_text(note)}</li>" for note in box_notes(scores, evaluation))
    return [*parts, "<ul>", *notes, "</ul>"]


def _table(rows: Sequence[ModelScore], columns: Sequence[Column]) -> list[str]:
    heads = "".join(f"<th>{html_text(name)}</th>" for name in ("Method", *(c[0] for c in columns)))
    filled = [cells(rows, key, form, best) for _, key, form, best in columns]
    lines = [f'<div class="wide"><table><tr>{heads}</tr>']
    for index, row in enumerate(rows):
        line = "".join(f"<td>{_cell(column[index])}</td>" for column in filled)
        lines.append(f"<tr><td>{html_text(row.model)}</td>{line}</tr>")
    return [*lines, "</table></div>"]


def _cell(text: str) -> str:
    """Format a cell; bold Markdown becomes bold HTML."""
    bare = text.removeprefix("**").removesuffix("**")
    return html_text(bare) if bare == text else f"<strong>{html_text(bare)}</strong>"


def _figure(item: Comparison) -> str:
    """Show baseline and result, or photo and result if there is one model, with a slider."""
    left, right = item.pictures[-2], item.pictures[-1]
    width, height = item.size
    photo, reference = item.pictures[0], ""
    if left is not photo:
        shown = _image(photo, width, height)
        reference = f"<details><summary>Photo</summary>{shown}</details>"
    sides = f"{_named(left)} | {_named(right)}"
    return (
        f'<figure><div class="slider" style="width:{width}px;aspect-ratio:{width}/{height}">'
        f"{_image(left, width, height)}{_image(right, width, height)}"
        f'<input type="range" min="0" max="100" value="50" aria-label="{sides}"></div>'
        f"<figcaption>{sides}<br>{html_text(item.view)} ({html_text(item.label)})</figcaption>"
        f"{reference}</figure>"
    )


def _named(shown: Shown) -> str:
    return html_text(shown.name if shown.psnr is None else f"{shown.name}: {shown.psnr:.2f} dB")


def _image(shown: Shown, width: int, height: int) -> str:
    data = base64.b64encode(shown.jpeg).decode()
    source = f"data:image/jpeg;base64,{data}"
    return f'<img alt="{html_text(shown.name)}" width="{width}" height="{height}" src="{source}">'


WIDTH, HEIGHT = 640, 280
LEFT, RIGHT, TOP, BOTTOM = 60, 180, 20, 45  # margins; names are in the right one
MARGIN = 0.08  # space above and below, as a share of the range of PSNR


def _plot(rows: Sequence[ModelScore]) -> list[str]:
    """Plot PSNR against seconds as SVG, a point for each model; nothing for fewer than two."""
    points = [
        (row.model, row.seconds, row.roi_psnr)
        for row in rows
        if row.seconds > 0 and row.roi_psnr is not None
    ]
    if len(points) < 2:
        return []
    low, high = min(p for *_, p in points), max(p for *_, p in points)
    space = MARGIN * (high - low) or 0.5
    low, high, longest = low - space, high + space, max(seconds for _, seconds, _ in points)
    wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    bottom = TOP + tall
    lines = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img"'
        ' aria-label="ROI PSNR against training seconds">',
        f'<path d="M{LEFT} {TOP}V{bottom}H{LEFT + wide}" fill="none" stroke="currentColor"/>',
        f'<text x="{LEFT}" y="{HEIGHT - 8}">training time (seconds)</text>',
        f'<text x="{LEFT + wide}" y="{bottom + 18}" text-anchor="end">{longest:,.0f}</text>',
        f'<text x="{LEFT}" y="{bottom + 18}">0</text>',
        f'<text x="{LEFT - 6}" y="{TOP + 10}" text-anchor="end">{high:.1f} dB</text>',
        f'<text x="{LEFT - 6}" y="{bottom}" text-anchor="end">{low:.1f}</text>',
    ]
    for name, seconds, psnr in points:
        x = LEFT + wide * seconds / longest
        y = TOP + tall * (high - psnr) / (high - low)
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="#ffa000"/>')
        lines.append(f'<text x="{x + 9:.1f}" y="{y + 4:.1f}">{html_text(name)}</text>')
    return [*lines, "</svg>"]
