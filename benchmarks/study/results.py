"""The records, and numbers from them: one for each seed, mean and standard deviation."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.markdown import NONE
from benchmarks.study.rows import TUNED as TUNED_ROW
from roigs_engine.evaluation.scores import FULL_SCENE as BASELINE
from roigs_engine.evaluation.scores import FULL_SCENE_TUNED as TUNED
from roigs_engine.evaluation.scores import Evaluation, Gains, ModelScore, mean, near_and_far
from roigs_engine.formats.files import read_json
from roigs_engine.requests.choices import TEST

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
    """One model in one box, in one seed.

    Attributes:
        record: where it was measured.
        box: the box.
        score: its numbers.
        plain: Full Scene of the same record; None: this is it.
        baseline: what gains are over, of the same seed; None: it is not measured, or on other
            photos, because one was lost in between.
    """

    record: dict[str, Any]
    box: str
    score: ModelScore
    plain: Entry | None = None
    baseline: Entry | None = None

    @property
    def photos(self) -> set[str]:
        """Names of the photos that count."""
        return {view.view for view in self.score.views}

    @property
    def gains(self) -> dict[str, float]:
        """Test view -> gain in ROI PSNR over the baseline, dB; empty if there is none."""
        if self.baseline is None or self.baseline.score.model == self.score.model:
            return {}
        before = {view.view: view.roi_psnr for view in self.baseline.score.views}
        return {view.view: view.roi_psnr - before[view.view] for view in self.score.views}

    @property
    def summary(self) -> Gains:
        """The best and the worst photo, and the share of photos won; empty without gains."""
        return Gains.of(self.gains)

    def near(self) -> float | None:
        """Mean ROI PSNR on the near third of the photos."""
        return self._third(far=False)

    def far(self) -> float | None:
        """The same on the far third."""
        return self._third(far=True)

    def _third(self, *, far: bool) -> float | None:
        # The record's own distances: those of the scores are missing in records of version 0.1.0.
        distances = self.record["distances"][self.box]
        psnr = {view.view: view.roi_psnr for view in self.score.views}
        third = near_and_far({name: distances[name] for name in psnr})[far]
        return mean([psnr[name] for name in third])

    def spent(self, clock: str) -> float:
        """Training `seconds` or `cpu_seconds`."""
        names = self.record["models"][self.box][self.score.model]
        return float(sum(self.record["stages"][name][clock] for name in names))

    def ratio(self, value: Callable[[Entry], float]) -> float | None:
        """A number relative to the baseline's; None without one."""
        return value(self) / max(value(self.baseline), 1e-9) if self.baseline else None

    def selected(self) -> float | None:
        """Photos selected for the box; None where none are."""
        chosen = self.record["selected"].get(self.box)
        return None if chosen is None else float(chosen["chosen"])


Number = Callable[[Entry], float | None]


def _gain(value: Number) -> Number:
    """A number minus that of the baseline."""
    return lambda entry: _over(entry, entry.baseline, value)


def _over(entry: Entry, other: Entry | None, value: Number) -> float | None:
    """A number minus that of another model; None if there is none."""
    if other is None or other.score.model == entry.score.model:
        return None
    after, before = value(entry), value(other)
    return None if after is None or before is None else after - before


METRICS: dict[str, Number] = {
    "roi_psnr": lambda e: e.score.roi_psnr,
    "roi_ssim": lambda e: e.score.roi_ssim,
    "roi_flip": lambda e: e.score.roi_flip,
    "near_psnr": Entry.near,
    "far_psnr": Entry.far,
    "object_psnr": lambda e: e.score.object_psnr,
    "image_psnr": lambda e: e.score.image_psnr,
    "gain": _gain(lambda e: e.score.roi_psnr),
    "full_scene_gain": lambda e: _over(e, e.plain, lambda entry: entry.score.roi_psnr),
    "near_gain": _gain(Entry.near),
    "far_gain": _gain(Entry.far),
    "ssim_gain": _gain(lambda e: e.score.roi_ssim),
    "flip_gain": _gain(lambda e: e.score.roi_flip),
    "object_gain": _gain(lambda e: e.score.object_psnr),
    "corrected_gain": _gain(lambda e: e.score.corrected_psnr),
    "detail_gain": _gain(lambda e: e.score.detail_psnr),
    "image_gain": _gain(lambda e: e.score.image_psnr),
    "peak_gain": lambda e: e.summary.peak_gain,
    "worst_gain": lambda e: e.summary.worst_gain,
    "won_share": lambda e: e.summary.won_share,
    "gaussians": lambda e: e.score.gaussians,
    "gaussians_ratio": lambda e: e.ratio(lambda entry: entry.score.gaussians),
    "in_box": lambda e: e.score.gaussians_in_box,
    "seconds": lambda e: e.spent("seconds"),
    "cpu_seconds": lambda e: e.spent("cpu_seconds"),
    "cpu_ratio": lambda e: e.ratio(lambda entry: entry.spent("cpu_seconds")),
    "megabytes": lambda e: e.score.ply_bytes / 1e6,
    "selected": lambda e: e.selected(),
}
"""Name -> number of an entry; None where there is none."""


class Results:
    """All records of a study.

    Attributes:
        records: as they were written.
        boxes: (scene, box) in the order of the scenes given, then by name.
        tuned: whether the tuned Full Scene was measured; gains are over it then.
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
        self.tuned = any(record["row"] == TUNED_ROW for record in self.records)
        for (scene, box, _, _), entries in self._entries.items():
            tuned = self.entries(scene, box, TUNED_ROW, TUNED) if self.tuned else {}
            for seed, entry in entries.items():
                baseline = tuned.get(seed) if self.tuned else entry.plain or entry
                if baseline is None or baseline.photos == entry.photos:
                    entries[seed] = replace(entry, baseline=baseline)

    @property
    def baseline(self) -> str:
        """The model that gains are over."""
        return TUNED if self.tuned else BASELINE

    @property
    def photos(self) -> str:
        """The photos of the measurement: `test` or `validation`."""
        found = (record["evaluation"].get("photos") for record in self.records)
        return next((photos for photos in found if photos), TEST)

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
            by_name = {
                score.model: Entry(record=record, box=scores.roi, score=score)
                for score in scores.rows
            }
            for name, entry in by_name.items():
                if name == BASELINE and len(by_name) > 1:
                    continue  # it has a row of its own
                key = (record["scene"], scores.roi, record["row"], name)
                plain = None if name == BASELINE else by_name[BASELINE]
                self._entries.setdefault(key, {})[record["seed"]] = replace(entry, plain=plain)


def load_records(folder: Path) -> list[dict[str, Any]]:
    """All records below `folder`, as SCENE/seed-N/ROW.json.

    Raises:
        RunFolderError: one cannot be read.
    """
    return [read_json(path) for path in sorted(folder.glob("*/seed-*/*.json"))]
