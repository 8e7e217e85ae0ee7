"""Measurements as Markdown tables; what each column means stands in benchmarks/README.md."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from benchmarks.markdown import table
from benchmarks.results import CPU, STAGES, WALL, Measurement, growth

RASTER = ("raster", "raster backward")


def stage_table(measurements: Sequence[Measurement]) -> str:
    """Milliseconds per stage."""
    rows = (
        [
            *_names(m),
            *(f"{m.milliseconds(s, WALL):.2f} ({m.milliseconds(s, CPU):.2f})" for s in STAGES),
        ]
        for m in measurements
    )
    return _table(STAGES, rows)


def work_table(measurements: Sequence[Measurement]) -> str:
    """Counts per image, time per pair evaluation, share of the FMA peak, memory."""
    head = ["visible", "intersections", "pairs", "pairs / px", "ns / pair", "ns / pair backward"]
    head += ["peak GFLOP/s", "raster", "raster backward", "both", "memory MB"]

    def cells(m: Measurement) -> list[str]:
        pairs = m.count("pairs")
        per_pixel = None if pairs is None else pairs / (m.row.width * m.row.height)
        shares = (m.share_of_peak(stages) for stages in ([RASTER[0]], [RASTER[1]], RASTER))
        return [
            *(_number(m.count(name), ",.0f") for name in ("visible", "intersections", "pairs")),
            _number(per_pixel, ".1f"),
            *(_number(m.nanoseconds_per_pair(stage), ".3f") for stage in RASTER),
            f"{m.peak:.0f}",
            *(_number(share, ".0%") for share in shares),
            _number(None if m.memory is None else m.memory / 1e6, ",.0f"),
        ]

    return _table(head, ([*_names(m), *cells(m)] for m in measurements))


def growth_table(measurements: Sequence[Measurement]) -> str:
    """A step's CPU time, and a linear fit in visible Gaussians and pairs; shortest first."""
    head = ["visible", "pairs", "step CPU ms", "fit ms", "step / fit"]
    head += ["fit: ns / visible", "fit: ns / pair", "exponent"]
    rows: list[list[str]] = []
    for _, same in groupby(sorted(measurements, key=_variant), key=_variant):
        group = sorted(same, key=lambda m: m.milliseconds("step", CPU))
        fit = growth(group)
        if fit is None:
            continue
        for m in group:
            time, expected = m.milliseconds("step", CPU), fit.milliseconds(m)
            rows.append(
                [
                    *_names(m),
                    *(_number(m.count(name), ",.0f") for name in ("visible", "pairs")),
                    *(f"{time:.2f}", f"{expected:.2f}", f"{time / expected:.2f}"),
                    *(f"{fit.per_visible:.0f}", f"{fit.per_pair:.2f}", f"{fit.exponent:.2f}"),
                ]
            )
    return _table(head, rows)


def ratio_table(measurements: Sequence[Measurement]) -> str:
    """Ratio of medians: each row's later variants over its first variant."""
    rows = (
        [
            *_names(m),
            *(f"{_ratio(m, base, s, CPU):.3f} ({_ratio(m, base, s, WALL):.3f})" for s in STAGES),
        ]
        for base, m in _pairs(measurements)
    )
    return _table(STAGES, rows)


def extras_table(measurements: Sequence[Measurement]) -> str:
    """Ratio of times with and without optional outputs: of rendering, and of its raster stage."""
    options = [option for option in measurements[0].extras[0][0] if option != "plain"]
    rows = (
        [
            *_names(m),
            *(
                f"{m.extra_cost(o, 'render'):.3f} ({m.extra_cost(o, 'raster'):.3f})"
                for o in options
            ),
        ]
        for m in measurements
    )
    return _table(options, rows)


_NAMES = ["engine", "ISA", "Gaussians", "size", "threads"]


def _names(m: Measurement) -> list[str]:
    size = f"{m.row.width} × {m.row.height}"
    return [m.engine, m.isa, f"{m.row.gaussians:,}", size, str(m.row.threads)]


def _variant(m: Measurement) -> tuple[str, str, int]:
    return m.engine, m.isa, m.row.threads


def _pairs(measurements: Sequence[Measurement]) -> Iterator[tuple[Measurement, Measurement]]:
    first: dict[object, Measurement] = {}
    for m in measurements:
        base = first.setdefault(m.row, m)
        if base is not m:
            yield base, m


def _ratio(m: Measurement, base: Measurement, stage: str, clock: int) -> float:
    below = base.median(stage, clock)
    return m.median(stage, clock) / below if below else float("nan")


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(table([*_NAMES, *head], rows))
