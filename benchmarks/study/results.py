"""What was recorded, and numbers from it: one for each seed, their mean and standard deviation."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.markdown import NONE
from roigs_engine.evaluation.scores import Evaluation, ModelScore
from roigs_engine.evaluation.summaries import Gains, mean, near_and_far
from roigs_engine.formats.files import read_json
from roigs_engine.run.strategies import BASELINE

ONE_SEED = " †"


@dataclass(frozen=True)
class Stat:
    """A number by seed."""

    values: dict[int, float] = field(default_factory=dict)

    @property
    def mean(self) -> float | None:
        """Over the seeds; None without any."""
        return statistics.fmean(self.values.values()) if self.values else None

    @property
    def deviation(self) -> float | None:
        """The sample's standard deviation; None for fewer than two seeds."""
        return statistics.stdev(self.values.values()) if len(self.values) > 1 else None

    def minus(self, other: Stat) -> Stat:
        """The difference in the seeds that both have."""
        both = self.values.keys() & other.values.keys()
        return Stat({seed: self.values[seed] - other.values[seed] for seed in sorted(both)})

    def text(self, form: str) -> str:
        """Mean and deviation; a single seed is marked, none is a dash."""
        if self.mean is None:
            return NONE
        if self.deviation is None:
            return format(self.mean, form) + ONE_SEED
        return f"{self.mean:{form}} ± {self.deviation:{form.removeprefix('+')}}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        seeds = {str(seed): value for seed, value in self.values.items()}
        return {"mean": self.mean, "std": self.deviation, "n": len(seeds), "seeds": seeds}


def mean_of(stats: Sequence[Stat]) -> Stat:
    """Their mean in each seed that all of them have."""
    seeds = set.intersection(*(set(s.values) for s in stats)) if stats else set()
    return Stat({seed: statistics.fmean(s.values[seed] for s in stats) for seed in sorted(seeds)})


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """One model in one box, in one seed; `baseline` is Full Scene of the same seed."""

    record: dict[str, Any]
    box: str
    score: ModelScore
    baseline: ModelScore

    @property
    def gains(self) -> dict[str, float]:
        """Test view -> gain in ROI PSNR over Full Scene, dB."""
        before = {view.view: view.roi_psnr for view in self.baseline.views}
        return {view.view: view.roi_psnr - before[view.view] for view in self.score.views}

    @property
    def summary(self) -> Gains:
        """The best and the worst photo, and the share of photos won; empty for Full Scene."""
        return Gains() if self.score.model == self.baseline.model else Gains.of(self.gains)

    def near(self, score: ModelScore) -> float | None:
        """Mean ROI PSNR of a model on the near third of the photos."""
        return self._third(score, far=False)

    def far(self, score: ModelScore) -> float | None:
        """The same on the far third."""
        return self._third(score, far=True)

    def _third(self, score: ModelScore, *, far: bool) -> float | None:
        # The record's own distances: those of the scores are missing in records of version 0.1.0.
        distances = self.record["distances"][self.box]
        psnr = {view.view: view.roi_psnr for view in score.views}
        third = near_and_far({name: distances[name] for name in psnr})[far]
        return mean([psnr[name] for name in third])

    def spent(self, clock: str, model: str | None = None) -> float:
        """Training `seconds` or `cpu_seconds` of this model, or of another one of the record."""
        names = self.record["models"][self.box][model or self.score.model]
        return float(sum(self.record["stages"][name][clock] for name in names))

    def selected(self) -> float | None:
        """Photos selected for the box; None where none are."""
        chosen = self.record["selected"].get(self.box)
        return None if chosen is None else float(chosen["chosen"])


Number = Callable[[Entry], float | None]


def _gain(value: Callable[[Entry, ModelScore], float | None]) -> Number:
    def gain(entry: Entry) -> float | None:
        after, before = value(entry, entry.score), value(entry, entry.baseline)
        if entry.score.model == entry.baseline.model or after is None or before is None:
            return None
        return after - before

    return gain


METRICS: dict[str, Number] = {
    "roi_psnr": lambda e: e.score.roi_psnr,
    "roi_ssim": lambda e: e.score.roi_ssim,
    "roi_flip": lambda e: e.score.roi_flip,
    "near_psnr": lambda e: e.near(e.score),
    "far_psnr": lambda e: e.far(e.score),
    "object_psnr": lambda e: e.score.object_psnr,
    "image_psnr": lambda e: e.score.image_psnr,
    "gain": _gain(lambda _, score: score.roi_psnr),
    "near_gain": _gain(Entry.near),
    "far_gain": _gain(Entry.far),
    "ssim_gain": _gain(lambda _, score: score.roi_ssim),
    "flip_gain": _gain(lambda _, score: score.roi_flip),
    "object_gain": _gain(lambda _, score: score.object_psnr),
    "image_gain": _gain(lambda _, score: score.image_psnr),
    "peak_gain": lambda e: e.score.peak_gain,
    "worst_gain": lambda e: e.summary.worst,
    "won_share": lambda e: e.summary.won,
    "gaussians": lambda e: e.score.gaussians,
    "gaussians_ratio": lambda e: e.score.gaussians / max(e.baseline.gaussians, 1),
    "in_box": lambda e: e.score.gaussians_in_box,
    "seconds": lambda e: e.spent("seconds"),
    "cpu_seconds": lambda e: e.spent("cpu_seconds"),
    "cpu_ratio": lambda e: e.spent("cpu_seconds") / e.spent("cpu_seconds", BASELINE),
    "megabytes": lambda e: e.score.ply_bytes / 1e6,
    "selected": lambda e: e.selected(),
}
"""Name -> number of an entry; None where there is none."""


class Results:
    """All records of a study.

    Attributes:
        records: as they were written.
        boxes: (scene, box) in the order of the scenes given, then by name.
    """

    def __init__(self, records: Iterable[dict[str, Any]], scenes: Sequence[str] = ()) -> None:
        self.records = list(records)
        found = {record["scene"] for record in self.records}
        names = [*scenes, *sorted(found - set(scenes))]
        self.boxes: list[tuple[str, str]] = []
        for name in names:
            of_scene = (r for r in self.records if r["scene"] == name)
            self.boxes += dict.fromkeys((name, box) for r in of_scene for box in r["models"])
        self._entries: dict[tuple[str, str, str, str], dict[int, Entry]] = {}
        for record in self.records:
            self._take(record)

    def entries(self, scene: str, box: str, row: str, model: str) -> dict[int, Entry]:
        """Seed -> the entry."""
        return self._entries.get((scene, box, row, model), {})

    def stat(self, scene: str, box: str, row: str, model: str, metric: str) -> Stat:
        """A metric of a model by seed."""
        entries = self.entries(scene, box, row, model)
        values = {seed: METRICS[metric](entry) for seed, entry in sorted(entries.items())}
        return Stat({seed: value for seed, value in values.items() if value is not None})

    def mean(self, row: str, model: str, metric: str) -> Stat:
        """A metric's mean over all boxes, in the seeds that all of them have."""
        return mean_of([self.stat(*place, row, model, metric) for place in self.boxes])

    def result(self, row: str) -> str:
        """The last model of a row, which is its result; empty where there is no record."""
        for record in self.records:
            if record["row"] == row:
                return str(list(next(iter(record["models"].values())))[-1])
        return ""

    def _take(self, record: dict[str, Any]) -> None:
        evaluation = Evaluation.from_dict(record["evaluation"])
        for scores in evaluation.rois:
            by_name = {score.model: score for score in scores.rows}
            for name, score in by_name.items():
                if name == BASELINE and len(by_name) > 1:
                    continue  # it has a row of its own
                key = (record["scene"], scores.roi, record["row"], name)
                self._entries.setdefault(key, {})[record["seed"]] = Entry(
                    record=record, box=scores.roi, score=score, baseline=by_name[BASELINE]
                )


def load_records(folder: Path) -> list[dict[str, Any]]:
    """All records below `folder`, as SCENE/seed-N/ROW.json.

    Raises:
        RunFolderError: one cannot be read.
    """
    return [read_json(path) for path in sorted(folder.glob("*/seed-*/*.json"))]
