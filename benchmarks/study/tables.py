"""The study as a Markdown page and as JSON."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.markdown import NONE, table
from benchmarks.study.columns import (
    IN_TABLE_TWO,
    LINES,
    NOTES,
    OVER_PLAIN,
    RESULT,
    TABLE_ONE,
    TABLE_ONE_PHOTOS,
    TABLE_THREE,
    TABLE_TWO_GAINS,
    TABLE_TWO_PHOTOS,
    THREE_NOTES,
    Column,
    Line,
)
from benchmarks.study.results import METRICS, Results, Stat, mean_of
from benchmarks.study.rows import BEYOND, EQUAL_TIME, MATCHED, MATCHED_TUNED, PERCENTS, Row
from roigs_engine.evaluation.scores import FULL_SCENE_TUNED as TUNED


@dataclass(frozen=True, kw_only=True)
class Study:
    """The content of the page.

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
        parts += ["", self._notes()]
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

    def _notes(self) -> str:
        return NOTES.format(baseline=self.results.baseline, photos=self.results.photos)

    def _equal_time(self) -> list[str]:
        """Steps of the row of equal time, as a multiple of ours."""
        factors = [
            f"{record['scene']} {record['steps_factor']:.2g} (seed {record['seed']})"
            for record in self.results.records
            if record["row"] == EQUAL_TIME
        ]
        what = "Joint, equal time: our settings, with a longer box stage to take the CPU time of"
        return [f"{what} {TUNED}. Steps times: {', '.join(factors) or NONE}."]

    def _table_one(self) -> list[str]:
        parts = ["", "## Table I: one box"]
        for place in self.results.boxes:
            parts += ["", f"### {_place(place)}", ""]
            parts += self._one(place, TABLE_ONE)
            parts += ["", "Near and far, and single photos:", ""]
            parts += self._one(place, TABLE_ONE_PHOTOS)
        return parts

    def _one(self, place: tuple[str, str], columns: Sequence[Column]) -> list[str]:
        """A table of one box."""
        shown = self._shown(columns)
        rows = [
            [label, *self._cells(place, row, model, shown)] for label, row, model in self._lines()
        ]
        return table(["method", *_headings(shown), "seeds"], rows, names=1)

    def _shown(self, columns: Sequence[Column]) -> list[Column]:
        """Without those of FLIP if nothing has it, and gains over Full Scene if all are."""
        has_flip = any(
            self.results.stat(*place, row, model, "roi_flip").values
            for place in self.results.boxes
            for _, row, model in self._all_lines()
        )
        tuned = self.results.tuned
        columns = [c for c in columns if tuned or c != OVER_PLAIN]
        return [column for column in columns if has_flip or "flip" not in column[1]]

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
        head += [*over, "over matched", *_headings(TABLE_TWO_GAINS)]
        head += ["Gaussians ×", "CPU ×", "seeds"]
        columns = [
            [
                *(results.stat(*place, row, model, "roi_psnr") for _, row, model in shown),
                *self._comparisons(place),
            ]
            for place in results.boxes
        ]
        forms = [".2f"] * len(shown) + ["+.2f"] * (len(over) + 1)
        forms += [*(form for _, _, form in TABLE_TWO_GAINS), ".2f", ".2f"]
        title = f"## Table II: all boxes, ours = {ours}"
        parts = ["", title, "", *table(head, self._two(columns, forms, len(shown)), names=2)]
        return [*parts, *self._two_photos()]

    def _two_photos(self) -> list[str]:
        """The second table of all boxes: near and far, and single photos."""
        results, ours = self.results, RESULT[self.own][0]
        photos = self._shown(TABLE_TWO_PHOTOS)
        head = ["scene", "box", *_headings(photos), "seeds"]
        columns = [
            [results.stat(*place, self.own, ours, metric) for _, metric, _ in photos]
            for place in results.boxes
        ]
        forms = [form for _, _, form in photos]
        rows = self._two(columns, forms, _headings(photos).index("peak gain"), some=True)
        title = f"Near and far, and single photos, {ours}:"
        return ["", title, "", *table(head, rows, names=2)]

    def _two(
        self,
        columns: Sequence[Sequence[Stat]],
        forms: Sequence[str],
        counted: int,
        *,
        some: bool = False,
    ) -> list[list[str]]:
        """The lines of a table of all boxes, their mean last.

        Args:
            columns: the numbers of each box.
            forms: their formats.
            counted: the number whose seeds are counted for the mean.
            some: a box that has this number may lack others, whose mean is that of the other boxes;
                else all boxes must have all.
        """
        ours, rows = RESULT[self.own][0], []
        for place, stats in zip(self.results.boxes, columns, strict=True):
            seeds = len(self.results.entries(*place, self.own, ours))
            rows.append([*place, *_texts(stats, forms), str(seeds)])
        if len(columns) > 1:
            may_lack = [some and bool(stats[counted].values) for stats in columns]
            means = [
                mean_of([s for s, may in zip(stats, may_lack, strict=True) if s.values or not may])
                for stats in zip(*columns, strict=True)
            ]
            seeds = len(means[counted].values)
            rows.append(["mean", "all", *_texts(means, forms), str(seeds)])
        return rows

    def _comparisons(self, place: tuple[str, str]) -> list[Stat]:
        """The columns of Table II that compare ours with others, in one box."""
        ours = RESULT[self.own][0]

        def stat(metric: str, row: str = self.own, model: str = ours) -> Stat:
            return self.results.stat(*place, row, model, metric)

        matched = (MATCHED_TUNED, "Matched, tuned") if self.results.tuned else (MATCHED, "Matched")
        plain = [stat("full_scene_gain")] if self.results.tuned else []
        return [
            stat("gain"),
            *plain,
            stat("roi_psnr").minus(stat("roi_psnr", *matched)),
            *(stat(metric) for _, metric, _ in TABLE_TWO_GAINS),
            stat("gaussians_ratio"),
            stat("cpu_ratio"),
        ]

    def _table_three(self) -> list[str]:
        """The mean gain over all boxes by share of selected photos, then each box in full."""
        ablations = [row for row in self.rows if row.percent]
        parts = ["", "## Table III: ablations", "", *THREE_NOTES.splitlines(), ""]
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
    """The kind of a row of Table III, without its share: `gp6-20` is `gp6`."""
    return row.name.removesuffix(f"-{row.percent}")
