"""Figures of the study: bars, gain by distance, curves over K, crops; PNGs and one PDF of all.

They need matplotlib (the extra `study`); without it there are only tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from benchmarks.study.columns import LINES, RESULT, Line
from benchmarks.study.results import Results, Stat
from benchmarks.study.rows import BEYOND, Row
from benchmarks.study.tables import kind_of
from roigs_engine.context import Emit
from roigs_engine.evaluation.scores import FULL_SCENE as BASELINE
from roigs_engine.formats.events import Message

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
CROPS = ("largest gain", "least gain")
COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb", "#000000")


def write_figures(
    results: Results, rows: Sequence[Row], own: str, out: Path, emit: Emit
) -> dict[str, str]:
    """Write `figures/NAME.png` and `study.pdf` below `out`; title -> path from there."""
    try:
        import matplotlib
    except ImportError:
        text = "No figures: matplotlib is missing. Install the extra 'study'."
        emit(Message(text=text, level="warning"))
        return {}
    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.backends.backend_pdf import PdfPages

    if not results.boxes:
        return {}
    (out / "figures").mkdir(parents=True, exist_ok=True)
    written = {}
    with PdfPages(out / "study.pdf") as pages:
        for title, name, draw in _figures(results, rows, own, out):
            figure = draw()
            if figure is None:
                continue
            path = out / "figures" / f"{name}.png"
            figure.savefig(path, dpi=110)
            pages.savefig(figure)
            pyplot.close(figure)
            written[title] = str(path.relative_to(out))
    return written


Drawing = tuple[str, str, Callable[[], "Figure | None"]]


def _figures(results: Results, rows: Sequence[Row], own: str, out: Path) -> list[Drawing]:
    """Title, file name and drawing of each figure."""
    found: list[Drawing] = [
        (f"Gain over {results.baseline}", "gain", partial(_bars, results, rows)),
        ("Gain by distance", "distance", partial(_distances, results, own)),
        ("Gain by share of selected photos", "selected", partial(_curves, results, rows)),
    ]
    for scene in dict.fromkeys(scene for scene, _ in results.boxes):
        title = f"{scene}: photo, {BASELINE}, {RESULT[own][0]}"
        found.append((title, f"crops-{scene}", partial(_crops, results, scene, own, out)))
    return found


def _grid(results: Results, ylabel: str, xlabel: str) -> tuple[Figure, list[Axes]]:
    """A figure with axes for each box, titled with it."""
    from matplotlib import pyplot

    count = len(results.boxes)
    columns = min(COLUMNS, count)
    figure, axes = pyplot.subplots(
        math.ceil(count / columns),
        columns,
        figsize=(4.2 * columns, 3.3 * math.ceil(count / columns)),
        squeeze=False,
        layout="constrained",
    )
    flat = list(axes.flat)
    for place, one in zip(results.boxes, flat, strict=False):
        one.set_title(" ".join(place), fontsize=10)
        one.set_ylabel(ylabel, fontsize=9)
        one.set_xlabel(xlabel, fontsize=9)
    for one in flat[count:]:
        one.axis("off")
    return figure, flat[:count]


def _bars(results: Results, rows: Sequence[Row]) -> Figure | None:
    """Gain of every result in each box: the bar is the mean, dots are seeds."""
    shown: list[Line] = [line for line in LINES if line[2] not in (BASELINE, "Scene-GS (joint)")]
    variants = [row.name for row in rows if BEYOND in row.tables]
    shown += [(name, name, results.result(name)) for name in variants]
    figure, axes = _grid(results, "gain in ROI PSNR, dB", "")
    drawn = False
    for place, one in zip(results.boxes, axes, strict=True):
        stats = [(label, results.stat(*place, row, model, "gain")) for label, row, model in shown]
        stats = [(label, stat) for label, stat in stats if stat.values]
        for at, (_, stat) in enumerate(stats):
            drawn = True
            one.barh(at, stat.mean or 0.0, color=COLOURS[at % 7], alpha=0.6)
            one.plot(list(stat.values.values()), [at] * len(stat.values), "k.", markersize=4)
        one.set_yticks(range(len(stats)), [label for label, _ in stats], fontsize=8)
        one.invert_yaxis()
        one.axvline(0, color="0.4", linewidth=0.8)
        one.set_xlabel("gain in ROI PSNR, dB", fontsize=9)
        one.set_ylabel("")
    return figure if drawn else None


def _distances(results: Results, own: str) -> Figure | None:
    """The gain of ours on each test photo by distance to the box; colours are seeds."""
    figure, axes = _grid(results, "gain in ROI PSNR, dB", "distance to the box's centre")
    drawn = False
    for (scene, box), one in zip(results.boxes, axes, strict=True):
        one.axhline(0, color="0.6", linewidth=0.8)
        entries = results.entries(scene, box, own, RESULT[own][0])
        for at, (seed, entry) in enumerate(sorted(entries.items())):
            distances = entry.record["distances"][box]
            points = sorted((distances[view], gain) for view, gain in entry.gains.items())
            if not points:
                continue
            drawn = True
            one.plot(
                *zip(*points, strict=True),
                ".",
                color=COLOURS[at % len(COLOURS)],
                label=f"seed {seed}",
            )
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize=7)
    return figure if drawn else None


def _curves(results: Results, rows: Sequence[Row]) -> Figure | None:
    """Gain of each selection by the share of the candidates that it selects."""
    figure, axes = _grid(results, "gain in ROI PSNR, dB", "selected photos, % of candidates")
    drawn = False
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        if row.percent:
            kinds.setdefault(kind_of(row), []).append(row)
    for place, one in zip(results.boxes, axes, strict=True):
        one.axhline(0, color="0.6", linewidth=0.8)
        for at, (kind, members) in enumerate(kinds.items()):
            points: list[tuple[int, Stat]] = [
                (row.percent, results.stat(*place, row.name, results.result(row.name), "gain"))
                for row in sorted(members, key=lambda row: row.percent)
            ]
            points = [(percent, stat) for percent, stat in points if stat.values]
            if len(points) < 2:
                continue
            drawn = True
            one.errorbar(
                [percent for percent, _ in points],
                [stat.mean or 0.0 for _, stat in points],
                [stat.deviation or 0 for _, stat in points],
                color=COLOURS[at % len(COLOURS)],
                linestyle="-" if at < len(COLOURS) else "--",
                marker=".",
                capsize=2,
                linewidth=1,
                label=kind,
            )
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize=6, ncols=2)
    return figure if drawn else None


def _crops(results: Results, scene: str, own: str, out: Path) -> Figure | None:
    """Test photos of the largest and of the least gain, beside Full Scene and ours."""
    from matplotlib import pyplot

    pictures = []
    for place, box in results.boxes:
        entries = results.entries(place, box, own, RESULT[own][0]) if place == scene else {}
        if not entries:
            continue
        seed = min(entries)
        for label in CROPS:
            name = entries[seed].record["pictures"].get(box, {}).get(label)
            path = out / "pictures" / scene / f"seed-{seed}" / (name or "")
            if name and path.is_file():
                with Image.open(path) as file:
                    pictures.append((f"{box}, {label}, seed {seed}", file.convert("RGB")))
    if not pictures:
        return None
    heights = [picture.height / picture.width for _, picture in pictures]
    figure, axes = pyplot.subplots(
        len(pictures),
        1,
        figsize=(11, sum(10.5 * height + 0.35 for height in heights)),
        squeeze=False,
        layout="constrained",
        height_ratios=heights,
    )
    for (title, picture), one in zip(pictures, axes.flat, strict=True):
        one.imshow(picture, interpolation="lanczos")
        one.set_title(title, fontsize=9, loc="left")
        one.axis("off")
    return figure
