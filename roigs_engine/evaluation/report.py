"""The evaluation as a Markdown report and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..formats.files import write_json, write_text
from ..formats.run_files import REPORT, REPORT_DATA
from ..formats.text import counted
from .scores import MIN_OBJECT, MIN_SILHOUETTE, Evaluation, ModelScore, RoiScores

NONE = "–"  # a cell without a number
Key = Callable[[ModelScore], float | None]
# Heading, the row's number, its format, and which value is best: 1 highest, -1 lowest, 0 none.
COLUMNS: tuple[tuple[str, Key, str, int], ...] = (
    ("ROI PSNR (dB)", lambda row: row.roi_psnr, ".2f", 1),
    ("object PSNR (dB)", lambda row: row.object_psnr, ".2f", 1),
    ("ROI SSIM", lambda row: row.roi_ssim, ".4f", 1),
    ("image PSNR (dB)", lambda row: row.image_psnr, ".2f", 1),
    ("peak gain (dB)", lambda row: row.peak_gain, "+.2f", 1),
    ("Gaussians", lambda row: row.gaussians, ",d", -1),
    ("in box", lambda row: row.gaussians_in_box, ",d", 0),
    ("seconds", lambda row: row.seconds or None, ",.0f", -1),
    ("MB", lambda row: row.ply_bytes / 1e6, ",.1f", -1),
)


def format_markdown(evaluation: Evaluation) -> str:
    """One table per box, with the best value of each column in bold, and notes on the numbers."""
    count = len(evaluation.test_views)
    lines = [f"# Evaluation on {counted(count, f'{evaluation.photos} photo')}", ""]
    for scores in evaluation.rois:
        lines += [f"## box '{_text(scores.roi)}'", "", *_table(scores.rows), ""]
        lines += [f"- {line}" for line in _notes(scores, evaluation)]
        lines.append("")
    lines += [
        "PSNR: mean squared error over the mask's pixels and 3 channels, in dB, for each photo, "
        "then the mean over photos. SSIM: Wang et al. 2004, 11 x 11 Gaussian window, sigma 1.5, "
        "on RGB in [0, 1], computed on the full images, mean over the channels and the "
        "silhouette's pixels. MB: 10^6 bytes of the PLY.",
        "",
    ]
    return "\n".join(lines)


def write_report(evaluation: Evaluation, run_dir: Path) -> tuple[Path, Path]:
    """Write `report.md` and `report.json` (with each photo's numbers); returns both paths."""
    markdown, record = Path(run_dir) / REPORT, Path(run_dir) / REPORT_DATA
    write_json(record, evaluation.to_dict())
    write_text(markdown, format_markdown(evaluation))
    return markdown, record


def _text(text: str) -> str:
    """The text, escaped for a table cell."""
    return " ".join(text.split()).replace("|", "\\|")


def _table(rows: Sequence[ModelScore]) -> list[str]:
    """Header, rule and rows, padded so that the columns align in plain text."""
    columns = [["Method", *(_text(row.model) for row in rows)]]
    columns += [[heading, *_cells(rows, key, form, best)] for heading, key, form, best in COLUMNS]
    widths = [max(len(cell) for cell in column) for column in columns]
    lines = []
    for index in range(len(rows) + 1):
        cells = [column[index] for column in columns]
        padded = [cells[0].ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        lines.append("| " + " | ".join(padded) + " |")
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return [lines[0], "| " + " | ".join(rule) + " |", *lines[1:]]


def _cells(rows: Sequence[ModelScore], key: Key, form: str, best: int) -> list[str]:
    """The cells of a column, the best in bold; none is bold if all cells are equal."""
    values = [key(row) for row in rows]
    cells = [NONE if value is None else format(value, form) for value in values]
    present = [best * value for value in values if value is not None]
    if best == 0 or len(present) < 2 or len(set(cells)) == 1:
        return cells
    winner = format(best * max(present), form)
    return [f"**{cell}**" if cell == winner else cell for cell in cells]


def _notes(scores: RoiScores, evaluation: Evaluation) -> list[str]:
    """Notes on the pixels and photos behind the numbers of this box."""
    views = scores.views
    if not views:
        return [f"No {evaluation.photos} photo shows this box, so it has no numbers."]
    notes = [
        f"ROI: the silhouette of the box on {len(views)} of "
        f"{counted(len(evaluation.test_views), f'{evaluation.photos} photo')} "
        f"({_span([view.silhouette_pixels for view in views])} pixels)."
        + (f" Skipped photos, with fewer than {MIN_SILHOUETTE} pixels: {len(scores.left_out)}."
           if scores.left_out else "")
    ]  # fmt: skip
    large = [view.object_pixels for view in views if view.object_pixels >= MIN_OBJECT]
    mask = f"silhouette pixels whose expected depth in '{scores.object_mask_from}' is in the box"
    few = len(views) - len(large)
    if large:
        skipped = f"; {few} with fewer than {MIN_OBJECT} skipped in this column" if few else ""
        notes.append(
            f"Object: {mask}, the same for every row, on {counted(len(large), 'photo')} "
            f"({_span(large)} pixels{skipped})."
        )
    else:
        notes.append(f"Object: no photo has {MIN_OBJECT} {mask}.")
    for flag, what in (
        ("small", f"Fewer than {MIN_SILHOUETTE} pixels, used because no photo shows more"),
        ("camera_inside", "Camera inside the box, so the silhouette is the whole image"),
    ):
        flagged = [view.view for view in views if getattr(view, flag)]
        if flagged:
            notes.append(f"{what}: {', '.join(flagged)}.")
    peaks = [f"{row.model} {row.peak_view}" for row in scores.rows if row.peak_view is not None]
    if peaks:
        notes.append(f"Peak gain over '{evaluation.baseline}', on: {'; '.join(peaks)}.")
    stages = [
        f"{row.model} = " + " + ".join(f"{name} {spent:,.0f}" for name, spent in row.stages.items())
        for row in scores.rows
        if len(row.stages) > 1
    ]
    if stages:
        notes.append(f"Seconds by stage: {'; '.join(stages)}.")
    return notes


def _span(sizes: Sequence[int]) -> str:
    low, high = min(sizes), max(sizes)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
