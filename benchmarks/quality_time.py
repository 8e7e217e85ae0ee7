"""ROI PSNR against processor time: `python -m benchmarks.quality_time RUN ... --out FILE.png`.

Draws each row of the runs' reports: the mean over the boxes of a run, above the CPU seconds of all
stages that the model is made of. Needs matplotlib (the extra `study`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roigs_engine.evaluation.scores import FULL_SCENE, FULL_SCENE_TUNED, Evaluation
from roigs_engine.formats import run_files
from roigs_engine.formats.files import read_json
from roigs_engine.formats.stage_list import read_stage_list

SHOWN = {
    FULL_SCENE: ("#bbbbbb", "standard 3DGS"),
    FULL_SCENE_TUNED: ("#4477aa", "3DGS, tuned"),
    "Joint": ("#ee6677", "ROI-GS"),
}
"""Row -> its colour and name."""
MARKERS = "osD^v<>P"


def points(run: Path) -> dict[str, tuple[float, float]]:
    """Row -> CPU seconds of its stages, and ROI PSNR, mean over the boxes."""
    evaluation = Evaluation.from_dict(read_json(run / run_files.REPORT_DATA))
    found: dict[str, list[float]] = {}
    stages: dict[str, tuple[str, ...]] = {}
    for scores in evaluation.rois:
        for row in scores.rows:
            if row.model in SHOWN and row.roi_psnr is not None:
                found.setdefault(row.model, []).append(row.roi_psnr)
                stages[row.model] = tuple(row.stages) or (run_files.FULL_SCENE_STAGE,)
    return {
        name: (sum(_cpu_seconds(run, stage) for stage in stages[name]), float(np.mean(values)))
        for name, values in found.items()
    }


def _cpu_seconds(run: Path, stage: str) -> float:
    return float(read_json(read_stage_list(run)[stage] / run_files.STAGE)["cpu_seconds"])


def draw(runs: Sequence[Path], out: Path) -> None:
    """Write the picture."""
    try:
        import matplotlib
    except ImportError:
        sys.exit("matplotlib is missing. Install the extra 'study': pip install -e '.[study]'.")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.2))
    drawn: set[str] = set()
    for index, (marker, run) in enumerate(zip(MARKERS, runs, strict=False)):
        rows = points(run)
        order = [name for name in SHOWN if name in rows]
        axes.plot(*zip(*(rows[name] for name in order), strict=True), color="#dddddd", zorder=1)
        for name in order:
            axes.scatter(*rows[name], color=SHOWN[name][0], marker=marker, s=60, zorder=2)
        beside = (8, -12 if index % 2 else 4)  # below and above, to separate near points' names
        axes.annotate(run.name, rows[order[-1]], xytext=beside, textcoords="offset points")
        drawn.update(order)
    for name, (colour, label) in SHOWN.items():
        if name in drawn:
            axes.scatter([], [], color=colour, label=label)
    axes.set_xlabel("CPU seconds of training")
    axes.set_ylabel("ROI PSNR, dB")
    axes.margins(0.12)
    axes.set_xlim(left=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.tight_layout()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)


def main(arguments: Sequence[str]) -> None:
    """Draw the picture from the runs' reports."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality_time", description=__doc__)
    parser.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="run folders with reports"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the picture")
    options = parser.parse_args(arguments)
    draw(options.runs, options.out)


if __name__ == "__main__":
    main(sys.argv[1:])
