"""The measurements, and the numbers of the tables made from them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import nnls

from benchmarks.flops import PER_PAIR

STAGES = ("project", "bin", "raster", "loss", "raster backward", "update", "rest", "step")
WALL, CPU = 0, 1


@dataclass(frozen=True)
class Row:
    """The measurements of one process."""

    gaussians: int
    width: int
    height: int
    threads: int


@dataclass
class Measurement:
    """A row, measured in one variant.

    Attributes:
        engine: git revision of the engine, or "this".
        isa: instruction set.
        counts: "visible", "intersections" and, if known, "pairs" -> number for each camera.
        rounds: for each round and camera: stage -> (wall, CPU) milliseconds.
        extras: for each round and camera: set of optional outputs -> the same.
        peak: GFLOP/s of one core, best of the rounds.
        memory: peak resident memory, bytes.
    """

    row: Row
    engine: str
    isa: str
    counts: dict[str, list[int]]
    rounds: list[list[dict[str, Sequence[float]]]] = field(default_factory=list)
    extras: list[list[dict[str, dict[str, Sequence[float]]]]] = field(default_factory=list)
    peak: float = 0.0
    memory: int | None = None

    def milliseconds(self, stage: str, clock: int) -> float:
        """Median over cameras of each one's fastest round, ms."""
        return statistics.median(self._fastest(stage, clock))

    def median(self, stage: str, clock: int) -> float:
        """Median over all rounds and cameras, ms; for comparisons between variants."""
        return statistics.median(c[stage][clock] for r in self.rounds for c in r)

    def count(self, name: str) -> float | None:
        """Median of a count over cameras; None if it is unknown."""
        return statistics.median(self.counts[name]) if name in self.counts else None

    def nanoseconds_per_pair(self, stage: str) -> float | None:
        """CPU time of a stage for a (Gaussian, pixel) pair, ns; median over cameras."""
        if "pairs" not in self.counts:
            return None
        times = zip(self._fastest(stage, CPU), self.counts["pairs"], strict=True)
        return statistics.median(1e6 * time / max(pairs, 1) for time, pairs in times)

    def share_of_peak(self, stages: Iterable[str]) -> float | None:
        """Useful FLOP per second of CPU time in these stages together, as share of the peak."""
        operations, nanoseconds = 0.0, 0.0
        for stage in stages:
            time = self.nanoseconds_per_pair(stage)
            if time is None:
                return None
            operations += PER_PAIR[stage]
            nanoseconds += time
        return operations / nanoseconds / self.peak

    def extra_cost(self, option: str, stage: str) -> float:
        """Ratio of CPU times with and without optional outputs; median over cameras of fastest."""
        cameras = zip(*self.extras, strict=True)  # the rounds of each camera
        ratios: list[float] = [
            min(r[option][stage][CPU] for r in rounds) / min(r["plain"][stage][CPU] for r in rounds)
            for rounds in cameras
        ]
        return statistics.median(ratios)

    def _fastest(self, stage: str, clock: int) -> list[float]:
        cameras = zip(*self.rounds, strict=True)
        return [min(times[stage][clock] for times in rounds) for rounds in cameras]


@dataclass(frozen=True)
class Growth:
    """Growth of a step's CPU time with its work, over rows that differ only in the work.

    Attributes:
        per_visible: nanoseconds per visible Gaussian in the linear fit
            time = per_visible * visible + per_pair * pairs.
        per_pair: nanoseconds per pair evaluation in this fit.
        exponent: p of the fit time ~ (the linear fit)^p; above 1 if the time grows faster than
            linearly.
    """

    per_visible: float
    per_pair: float
    exponent: float

    def milliseconds(self, m: Measurement) -> float:
        """The prediction of the linear fit for a row."""
        visible, pairs = m.count("visible") or 0, m.count("pairs") or 0
        return 1e-6 * (self.per_visible * visible + self.per_pair * pairs)


def growth(measurements: Sequence[Measurement]) -> Growth | None:
    """Fit by least squares of relative errors; None if counts are unknown or rows too few."""
    times = [m.milliseconds("step", CPU) for m in measurements]
    if any("pairs" not in m.counts for m in measurements) or len(times) < 3:
        return None
    counts = [[m.count(name) for name in ("visible", "pairs")] for m in measurements]
    shares = np.array(counts, dtype=float) / np.array(times)[:, None]
    per_visible, per_pair = nnls(shares, np.full(len(times), 1e6))[0]
    fit = Growth(per_visible, per_pair, 1.0)
    lengths = [math.log(fit.milliseconds(m)) for m in measurements]
    exponent = statistics.linear_regression(lengths, [math.log(t) for t in times]).slope
    return replace(fit, exponent=exponent)
