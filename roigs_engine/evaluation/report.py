"""The evaluation as a Markdown report and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..formats.files import write_json, write_text
from ..formats.run_files import REPORT, REPORT_DATA
from ..formats.targets import TARGETS
from ..formats.text import counted, markdown_text
from .scores import MIN_OBJECT, MIN_SILHOUETTE, Evaluation, ModelScore, RoiScores, near_and_far

NONE = "–"  # a cell without a number
Key = Callable[[ModelScore], float | None]
# Heading, function for the row's number, its format, the best value: 1 highest, -1 lowest, 0 none
Column = tuple[str, Key, str, int]
FLIP: Column = ("ROI FLIP", lambda row: row.roi_flip, ".4f", -1)
MASK: Column = ("mask PSNR (dB)", lambda row: row.mask_psnr, ".2f", 1)
CORRECTED: Column = ("corrected (dB)", lambda row: row.corrected_psnr, ".2f", 1)
DETAIL: Column = ("detail (dB)", lambda row: row.detail_psnr, ".2f", 1)
OPTIONAL = (FLIP, MASK, CORRECTED, DETAIL)
"""Columns that are shown only if they have a number."""
COLUMNS: tuple[Column, ...] = (
    ("ROI PSNR (dB)", lambda row: row.roi_psnr, ".2f", 1),
    CORRECTED,
    ("object PSNR (dB)", lambda row: row.object_psnr, ".2f", 1),
    MASK,
    ("ROI SSIM", lambda row: row.roi_ssim, ".4f", 1),
    FLIP,
    DETAIL,
    ("image PSNR (dB)", lambda row: row.image_psnr, ".2f", 1),
    ("Gaussians", lambda row: row.gaussians, ",d", -1),
    ("in box", lambda row: row.gaussians_in_box, ",d", 0),
    ("seconds", lambda row: row.seconds or None, ",.0f", -1),
    ("MB", lambda row: row.ply_bytes / 1e6, ",.1f", -1),
)
PHOTO_COLUMNS: tuple[Column, ...] = (
    ("near third (dB)", lambda row: row.near_psnr, ".2f", 1),
    ("near third, object (dB)", lambda row: row.near_object_psnr, ".2f", 1),
    ("far third (dB)", lambda row: row.far_psnr, ".2f", 1),
    ("peak gain (dB)", lambda row: row.peak_gain, "+.2f", 1),
    ("worst gain (dB)", lambda row: row.worst_gain, "+.2f", 1),
    ("photos won", lambda row: row.won_share, ".0%", 1),
)
FLIP_MEASURED = (
    "FLIP: Andersson et al. 2020, 67 pixels per degree, the mean error over the silhouette's "
    "pixels; 0 is best."
)
CORRECTED_MEANS = (
    "Corrected: ROI PSNR after multiplying each channel of the render, in the silhouette, by "
    "the factor that fits the photo best, so that another exposure or white balance is no "
    "error. "
)
DETAIL_MEANS = (
    "Detail: ROI PSNR after subtracting a blur (Gaussian, sigma 2 pixels) from render and "
    "photo, so that only sharpness counts. "
)
FLIP_MISSING = "No FLIP: `pip install flip-evaluator` adds this column."


def format_markdown(evaluation: Evaluation) -> str:
    """Format two tables per box, with the best value of each column in bold, and notes.

    The first table compares the models. The second one shows where they gain and lose: near and
    far, and on single photos. Columns of `OPTIONAL` and of the second table are shown only if they
    have a number.
    """
    count = len(evaluation.test_views)
    lines = [f"# Evaluation on {counted(count, f'{evaluation.photos} photo')}", ""]
    for scores in evaluation.rois:
        rows = scores.rows
        columns = shown_columns(rows)
        lines += [f"## box '{markdown_text(scores.roi)}'", "", *_table(rows, columns), ""]
        columns = [column for column in PHOTO_COLUMNS if has_number(rows, column)]
        if columns:
            lines += ["Near and far, and single photos:", "", *_table(rows, columns), ""]
        lines += [f"- {markdown_text(line)}" for line in box_notes(scores, evaluation)]
        lines.append("")
    seen = [row for scores in evaluation.rois for row in scores.rows if row.views]
    missing = bool(seen) and not has_number(seen, FLIP)
    lines += [
        "PSNR: mean squared error over the mask's pixels and 3 channels, in dB, for each photo, "
        "then the mean over photos. "
        + (CORRECTED_MEANS if has_number(seen, CORRECTED) else "")
        + (DETAIL_MEANS if has_number(seen, DETAIL) else "")
        + "SSIM: Wang et al. 2004, 11 x 11 Gaussian window, sigma 1.5, "
        "on RGB in [0, 1], computed on the full images, mean over the channels and the "
        "silhouette's pixels. "
        + (FLIP_MISSING if missing else FLIP_MEASURED)
        + " MB: 10^6 bytes of the PLY.",
        "",
    ]
    return "\n".join(lines)


def write_report(evaluation: Evaluation, run_dir: Path) -> tuple[Path, Path]:
    """Write `report.md` and `report.json` (with each photo's numbers); return both paths."""
    markdown, record = Path(run_dir) / REPORT, Path(run_dir) / REPORT_DATA
    write_json(record, evaluation.to_dict())
    write_text(markdown, format_markdown(evaluation))
    return markdown, record


def shown_columns(rows: Sequence[ModelScore]) -> list[Column]:
    """Return the columns of the first table; optional ones only if they have a number."""
    return [c for c in COLUMNS if c not in OPTIONAL or has_number(rows, c)]


def has_number(rows: Sequence[ModelScore], column: Column) -> bool:
    """Whether any row has a number in this column."""
    return any(column[1](row) is not None for row in rows)


def _table(rows: Sequence[ModelScore], shown: Sequence[Column]) -> list[str]:
    """Format header, rule and rows, padded so that columns align in plain text."""
    columns = [["Method", *(markdown_text(row.model) for row in rows)]]
    columns += [[heading, *cells(rows, key, form, best)] for heading, key, form, best in shown]
    widths = [max(len(cell) for cell in column) for column in columns]
    lines = []
    for index in range(len(rows) + 1):
        line = [column[index] for column in columns]
        padded = [line[0].ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
        lines.append("| " + " | ".join(padded) + " |")
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return [lines[0], "| " + " | ".join(rule) + " |", *lines[1:]]


def cells(rows: Sequence[ModelScore], key: Key, form: str, best: int) -> list[str]:
    """Format the cells of a column, the best in bold; none is bold if all are equal."""
    values = [key(row) for row in rows]
    texts = [NONE if value is None else format(value, form) for value in values]
    present = [best * value for value in values if value is not None]
    if best == 0 or len(present) < 2 or len(set(texts)) == 1:
        return texts
    winner = format(best * max(present), form)
    return [f"**{text}**" if text == winner else text for text in texts]


def box_notes(scores: RoiScores, evaluation: Evaluation) -> list[str]:
    """Describe the pixels and photos behind the numbers of this box."""
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
    if evaluation.masked:
        notes.append(
            f"{counted(evaluation.masked, 'photo')} with a mask: ignored pixels do not count in "
            "any column."
        )
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
    masked = sum(view.mask_psnr is not None for view in scores.rows[0].views) if scores.rows else 0
    if masked:
        others = "" if masked == len(views) else "; the others have no mask of it"
        notes.append(
            "Mask: the pixels that masks show as the object, on"
            f" {masked} of {counted(len(views), 'photo')}{others}."
        )
    for flag, what in (
        ("small", f"Fewer than {MIN_SILHOUETTE} pixels, used because no photo shows more"),
        ("camera_inside", "Camera inside the box, so the silhouette is the whole image"),
    ):
        flagged = [view.view for view in views if getattr(view, flag)]
        if flagged:
            notes.append(f"{what}: {', '.join(flagged)}.")
    notes += _photo_notes(scores.rows, evaluation.baseline)
    made_for: dict[str, list[str]] = {}
    for row in scores.rows:
        if row.made_for in TARGETS:
            made_for.setdefault(TARGETS[row.made_for].title, []).append(row.model)
    if len(made_for) > 1:
        each = "; ".join(f"{title}: {', '.join(models)}" for title, models in made_for.items())
        notes.append(f"Each model is drawn for its target: {each}.")
    stages = [
        f"{row.model} = " + " + ".join(f"{name} {spent:,.0f}" for name, spent in row.stages.items())
        for row in scores.rows
        if len(row.stages) > 1
    ]
    if stages:
        notes.append(f"Seconds by stage: {'; '.join(stages)}.")
    return notes


def _photo_notes(rows: Sequence[ModelScore], baseline: str) -> list[str]:
    """Describe the table of near, far and single photos."""
    notes = []
    views = rows[0].views if rows else ()
    distances = {view.view: view.distance for view in views if view.distance is not None}
    thirds = near_and_far(distances)
    if thirds[0]:
        spans = [[f"{distances[name]:.1f}" for name in (t[0], t[-1])] for t in thirds]
        near, far = (" to ".join(dict.fromkeys(ends)) for ends in spans)
        notes.append(
            f"Near third: mean ROI PSNR on the {len(thirds[0])} of {len(distances)} photos nearest "
            f"to the box ({near} box diagonals from its centre); object: the same of object PSNR. "
            f"Far third: on the {len(thirds[1])} farthest ({far})."
        )
    photos = [
        f"{row.model} {row.peak_view}, {row.worst_view}"
        for row in rows
        if row.worst_view is not None
    ]
    if photos:
        notes.append(
            f"Gains are in ROI PSNR over '{baseline}'. Photos won: those with a gain. Photos of "
            f"the peak and the worst gain: {'; '.join(photos)}."
        )
    return notes


def _span(sizes: Sequence[int]) -> str:
    low, high = min(sizes), max(sizes)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
