"""The study as a Markdown page and as JSON."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.markdown import NONE, table
from benchmarks.study import rows as kinds
from benchmarks.study.results import METRICS, Results, Stat, mean_of
from benchmarks.study.rows import (
    BEYOND,
    EQUAL_TIME,
    INDEPENDENT,
    JOINT,
    MATCHED,
    MATCHED_TUNED,
    PERCENTS,
    REFINED,
    Row,
)
from roigs_engine.run.strategies import BASELINE, TUNED

# A line of a table: what it is called, the row it comes from, the model of that row.
Line = tuple[str, str, str]

LINES: tuple[Line, ...] = (
    (BASELINE, kinds.FULL_SCENE, BASELINE),
    (TUNED, kinds.TUNED, TUNED),
    (f"{TUNED}, one stage", kinds.ONE_STAGE, f"{TUNED}, one stage"),
    ("Full Object", kinds.FULL_OBJECT, "Full Object"),
    ("Full Object, tuned", kinds.OBJECT_TUNED, "Full Object, tuned"),
    ("Full Scene, budget-matched", MATCHED, "Matched"),
    (f"{TUNED}, budget-matched", MATCHED_TUNED, "Matched, tuned"),
    ("Scene-GS", INDEPENDENT, "Scene-GS"),
    ("Object-GS", INDEPENDENT, "Object-GS"),
    ("Composition", INDEPENDENT, "Composition"),
    ("Object-GS (refined)", REFINED, "Object-GS"),
    ("Composition, refined", REFINED, "Composition, refined"),
    ("Scene-GS (joint)", JOINT, "Scene-GS (joint)"),
    ("Joint", JOINT, "Joint"),
    ("Joint, equal time", EQUAL_TIME, "Joint, equal time"),
)
IN_TABLE_TWO = (
    *(BASELINE, TUNED, "Matched", "Matched, tuned"),
    *("Composition", "Composition, refined", "Joint", "Joint, equal time"),
)
RESULT = {INDEPENDENT: ("Composition", "Scene-GS"), JOINT: ("Joint", "Scene-GS (joint)")}
"""Strategy -> its result's model, and its Scene-GS's."""

# Heading, metric, format.
Column = tuple[str, str, str]

OVER_PLAIN: Column = ("over Full Scene", "full_scene_gain", "+.2f")
"""Where gains are over the tuned Full Scene: those over the plain one, beside them."""
TABLE_ONE: tuple[Column, ...] = (
    ("ROI PSNR", "roi_psnr", ".2f"),
    ("gain", "gain", "+.2f"),
    OVER_PLAIN,
    ("SSIM", "roi_ssim", ".4f"),
    ("object PSNR", "object_psnr", ".2f"),
    ("image PSNR", "image_psnr", ".2f"),
    ("peak gain", "peak_gain", "+.2f"),
    ("Gaussians", "gaussians", ",.0f"),
    ("in box", "in_box", ",.0f"),
    ("s", "seconds", ",.0f"),
    ("CPU s", "cpu_seconds", ",.0f"),
    ("CPU ×", "cpu_ratio", ".2f"),
    ("MB", "megabytes", ".1f"),
)
TABLE_THREE: tuple[Column, ...] = (
    ("photos", "selected", ".0f"),
    ("ROI PSNR", "roi_psnr", ".2f"),
    ("gain", "gain", "+.2f"),
    ("SSIM", "roi_ssim", ".4f"),
    ("object PSNR", "object_psnr", ".2f"),
    ("in box", "in_box", ",.0f"),
    ("CPU ×", "cpu_ratio", ".2f"),
)
NOTES = """\
Gains are over {baseline} of the same seed, in dB. ROI: the silhouette of the box; object: those of
its pixels whose expected depth in Full Scene is in the box, the same in every row of a scene and
seed; peak gain: the largest on one test photo. ± is the sample's standard deviation over seeds;
† one seed only; - not measured. s: training, wall-clock; CPU s: the same by the process's clock,
all threads; CPU × and Gaussians ×: relative to {baseline}. Composition and Object-GS: the time for
this box alone. SSIM: 11 × 11 Gaussian window, sigma 1.5, mean over the silhouette. MB: 10^6
bytes of the PLY."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """What the page is about.

    Attributes:
        results: everything recorded.
        rows: that the tables show.
        tables: which of I, II, III.
        own: the preset's strategy, whose result is 'ours'.
        head: facts for the top of the page.
        figures: name -> path from the page.
    """

    results: Results
    rows: Sequence[Row]
    tables: Sequence[str]
    own: str
    head: dict[str, str]
    figures: dict[str, str]

    def markdown(self) -> str:
        """The page."""
        parts = ["# Study", "", *(f"- {name}: {value}" for name, value in self.head.items())]
        parts += ["", NOTES.format(baseline=self.results.baseline)]
        if EQUAL_TIME in {row.name for row in self.rows}:
            parts += ["", *self._equal_time()]
        if "I" in self.tables:
            parts += self._table_one()
        if "II" in self.tables:
            parts += self._table_two()
        if "III" in self.tables:
            parts += self._table_three()
        variants = [row for row in self.rows if BEYOND in row.tables]
        if variants:
            parts += self._beyond(variants)
        if self.figures:
            parts += ["", "## Figures"]
            for name, path in self.figures.items():
                parts += ["", f"![{name}]({path})"]
        return "\n".join(parts) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Every number by seed, with mean and standard deviation."""
        lines = []
        for scene, box in self.results.boxes:
            for _, row, model in self._all_lines():
                entries = self.results.entries(scene, box, row, model)
                if entries:
                    stats = {m: self.results.stat(scene, box, row, model, m) for m in METRICS}
                    lines.append(
                        {
                            "scene": scene,
                            "box": box,
                            "row": row,
                            "model": model,
                            "metrics": {m: stat.to_dict() for m, stat in stats.items()},
                            "gains": {str(seed): e.gains for seed, e in sorted(entries.items())},
                        }
                    )
        return {"head": self.head, "lines": lines, "own": self.own}

    def _all_lines(self) -> list[Line]:
        lines = list(LINES)
        known = {row for _, row, _ in LINES}
        for name in dict.fromkeys(str(r["row"]) for r in self.results.records):
            if name not in known:
                result = self.results.result(name)
                lines += [(name, name, "Object-GS")] if result == "Composition" else []
                lines.append((name, name, result))
        return lines

    def _lines(self) -> list[Line]:
        """The lines of Table I whose rows are asked for."""
        names = {row.name for row in self.rows}
        return [line for line in LINES if line[1] in names]

    def _equal_time(self) -> list[str]:
        """How many times our steps the row of equal time took."""
        factors = [
            f"{record['scene']} {record['steps_factor']:.2g} (seed {record['seed']})"
            for record in self.results.records
            if record["row"] == EQUAL_TIME
        ]
        what = "Joint, equal time: our settings with more steps, to take the CPU time of"
        return [f"{what} {TUNED}. Steps times: {', '.join(factors) or NONE}."]

    def _table_one(self) -> list[str]:
        columns = tuple(c for c in TABLE_ONE if c != OVER_PLAIN or self.results.tuned)
        parts = ["", "## Table I: one box"]
        for place in self.results.boxes:
            parts += ["", f"### {_place(place)}", ""]
            rows = [
                [label, *self._cells(place, row, model, columns)]
                for label, row, model in self._lines()
            ]
            parts += table(["method", *_headings(columns), "seeds"], rows, names=1)
        return parts

    def _cells(
        self, place: tuple[str, str], row: str, model: str, columns: Sequence[Column]
    ) -> list[str]:
        """A line's cells, the number of seeds last."""
        stats = [self.results.stat(*place, row, model, metric) for _, metric, _ in columns]
        cells = [stat.text(form) for stat, (_, _, form) in zip(stats, columns, strict=True)]
        return [*cells, str(len(self.results.entries(*place, row, model)))]

    def _table_two(self) -> list[str]:
        """A line for each box, and their mean."""
        results, ours = self.results, RESULT[self.own][0]
        shown = [
            (label, row, model) for label, row, model in self._lines() if model in IN_TABLE_TWO
        ]
        head = [*("scene", "box"), *(label for label, _, _ in shown)]
        over = ["gain", "over Full Scene"] if results.tuned else ["gain"]
        head += [*over, "over matched", "object gain", "peak gain", "image over Scene-GS"]
        head += ["Gaussians ×", "CPU ×", "seeds"]
        columns = [
            [
                *(results.stat(*place, row, model, "roi_psnr") for _, row, model in shown),
                *self._comparisons(place),
            ]
            for place in results.boxes
        ]
        forms = [".2f"] * len(shown) + ["+.2f"] * (4 + len(over)) + [".2f"] * 2
        rows = []
        for place, stats in zip(results.boxes, columns, strict=True):
            seeds = len(results.entries(*place, self.own, ours))
            rows.append([*place, *_texts(stats, forms), str(seeds)])
        if len(columns) > 1:
            means = [mean_of(stats) for stats in zip(*columns, strict=True)]
            seeds = len(means[len(shown)].values)
            rows.append(["mean", "all", *_texts(means, forms), str(seeds)])
        title = f"## Table II: all boxes, ours = {ours}"
        return ["", title, "", *table(head, rows, names=2)]

    def _comparisons(self, place: tuple[str, str]) -> list[Stat]:
        """The columns of Table II that compare ours with others, in one box."""
        ours, scene_gs = RESULT[self.own]

        def stat(metric: str, row: str = self.own, model: str = ours) -> Stat:
            return self.results.stat(*place, row, model, metric)

        matched = (MATCHED_TUNED, "Matched, tuned") if self.results.tuned else (MATCHED, "Matched")
        plain = [stat("full_scene_gain")] if self.results.tuned else []
        return [
            stat("gain"),
            *plain,
            stat("roi_psnr").minus(stat("roi_psnr", *matched)),
            stat("object_gain"),
            stat("peak_gain"),
            stat("image_psnr").minus(stat("image_psnr", self.own, scene_gs)),
            stat("gaussians_ratio"),
            stat("cpu_ratio"),
        ]

    def _table_three(self) -> list[str]:
        """The mean gain over all boxes by share of selected photos, then each box in full."""
        ablations = [row for row in self.rows if row.percent]
        parts = ["", "## Table III: ablations", "", *_THREE_NOTES.splitlines(), ""]
        kinds = list(dict.fromkeys(kind_of(row) for row in ablations))
        cells = []
        for kind in kinds:
            line = [kind]
            for percent in PERCENTS:
                name = next(
                    (r.name for r in ablations if kind_of(r) == kind and r.percent == percent), ""
                )
                line.append(self.results.mean(name, self.results.result(name), "gain").text("+.2f"))
            cells.append(line)
        parts += table(["mean gain over all boxes", *(f"{p} %" for p in PERCENTS)], cells, names=1)
        for place in self.results.boxes:
            parts += ["", f"### {_place(place)}", ""]
            head = ["method", "K", *_headings(TABLE_THREE), "Object-GS PSNR", "over unchanged"]
            rows = [self._ablation(place, row) for row in ablations]
            parts += table([*head, "seeds"], rows, names=2)
        return parts

    def _ablation(self, place: tuple[str, str], row: Row) -> list[str]:
        """A line of Table III in one box."""
        results, result = self.results, self.results.result(row.name)
        object_gs = results.stat(*place, row.name, "Object-GS", "roi_psnr")
        unchanged = results.stat(*place, row.kind, RESULT[row.kind][0], "roi_psnr")
        over = results.stat(*place, row.name, result, "roi_psnr").minus(unchanged)
        *shown, seeds = self._cells(place, row.name, result, TABLE_THREE)
        cells = [kind_of(row), f"{row.percent} %", *shown, object_gs.text(".2f")]
        return [*cells, NONE if row.name == row.kind else over.text("+.2f"), seeds]

    def _beyond(self, variants: Sequence[Row]) -> list[str]:
        """Each variant against the baseline and against the preset's own result."""
        results, (ours, _) = self.results, RESULT[self.own]
        parts = ["", "## Beyond", ""]
        parts += [
            f"- {row.name}: `{','.join(f'{name}={value}' for name, value in row.changes)}`"
            for row in variants
        ]
        head = ["variant", "scene", "box", "gain", f"over {ours}", "by seed", "object, over"]
        head += ["image, over", "Gaussians ×", "CPU ×", "seeds"]
        rows = []
        for variant in variants:
            model = results.result(variant.name)
            columns = []
            for place in results.boxes:
                stats = [
                    results.stat(*place, variant.name, model, "gain"),
                    *(
                        results.stat(*place, variant.name, model, metric).minus(
                            results.stat(*place, self.own, ours, metric)
                        )
                        for metric in ("roi_psnr", "object_psnr", "image_psnr")
                    ),
                    results.stat(*place, variant.name, model, "gaussians_ratio"),
                    results.stat(*place, variant.name, model, "cpu_ratio"),
                ]
                columns.append(stats)
                rows.append([variant.name, *place, *_beyond_cells(stats)])
            if len(columns) > 1:
                means = [mean_of(stats) for stats in zip(*columns, strict=True)]
                rows.append([variant.name, "mean", "all", *_beyond_cells(means)])
        return [*parts, "", *table(head, rows, names=3)]


_THREE_NOTES = """\
Each line changes one thing of the strategy: its photos or its start. All of them begin from the
strategy's own Scene-GS, which another selection does not change here. 48 %: what the preset selects
(48 % of the candidates, 150 photos at most). Scores are the composition's (joint: the joint
model's). Over unchanged: against the strategy's own row, seed by seed."""


def command_line(arguments: Sequence[str]) -> str:
    """The command as one would type it."""
    return f"`python -m benchmarks.study {shlex.join(arguments)}`"


def _place(place: tuple[str, str]) -> str:
    return f"{place[0]}, '{place[1]}'"


def _headings(columns: Sequence[Column]) -> list[str]:
    return [heading for heading, _, _ in columns]


def _texts(stats: Sequence[Stat], forms: Sequence[str]) -> list[str]:
    return [stat.text(form) for stat, form in zip(stats, forms, strict=True)]


def _beyond_cells(stats: Sequence[Stat]) -> list[str]:
    gain, over, objects, image, gaussians, cpu = stats
    by_seed = " ".join(f"{value:+.2f}" for value in over.values.values())
    texts = [stat.text("+.2f") for stat in (gain, over, objects, image)]
    return [
        *(texts[0], texts[1], by_seed, texts[2], texts[3]),
        *(gaussians.text(".2f"), cpu.text(".2f"), str(len(gain.values))),
    ]


def kind_of(row: Row) -> str:
    """What a row of Table III is, whatever its share: `gp6-20` is `gp6`."""
    return row.name.removesuffix(f"-{row.percent}")
