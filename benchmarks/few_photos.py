"""Few photos: `python -m benchmarks.few_photos SCENE ... --out DIR`; see benchmarks/README.md.

A person with a phone takes 12 to 24 photos. Each case cuts a capture down to so many (at random, as
an arc around the box, or evenly), with the points that two of them still see, and trains our model
and the tuned Full Scene. They are measured on all photos that were left out; of an arc, whose other
photos show other sides, on test photos. No case may fail badly, so the table has the worst photo.
DIR/CASE has the run of a case; a case that is done is not trained again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.markdown import table
from benchmarks.study.rows import changed, parse_variant
from benchmarks.study.scenes import StudyScene, parse_scenes
from roigs_engine.app.inputs import on_device
from roigs_engine.colmap.exposures import with_exposures
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.console import Console
from roigs_engine.commands.process import run_process
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.context import Context
from roigs_engine.evaluation.crops import write_crops
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.report import write_report
from roigs_engine.evaluation.scores import FULL_SCENE_TUNED, Evaluation
from roigs_engine.formats import run_files
from roigs_engine.formats.files import read_json
from roigs_engine.kernels import library
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.requests.choices import DEVICES
from roigs_engine.run.definition import define_run
from roigs_engine.run.folder import open_folder, train_opened
from roigs_engine.run.presets import preset
from roigs_engine.training.loop import one_torch_thread

KINDS = ("random", "arc", "even")
OURS = "Joint"


@dataclass(frozen=True, kw_only=True)
class Case:
    """A capture reduced to `count` photos; `seed` also affects which."""

    scene: str
    kind: str
    count: int
    seed: int

    @property
    def name(self) -> str:
        """Name of the case's folder."""
        return f"{self.scene}-{self.kind}-{self.count}-{self.seed}"


def cut(scene: SfmScene, box: OrientedBox, case: Case) -> SfmScene:
    """Reduce a scene to a case: its photos, and the points that at least two of them observe."""
    rng = np.random.default_rng([case.seed, case.count, KINDS.index(case.kind)])
    names = [image.name for image in scene.images]
    count = min(case.count, len(names))
    if case.kind == "random":
        kept = rng.choice(len(names), count, replace=False)
    else:
        rays = scene.centres() - box.centre
        _, _, axes = np.linalg.svd(rays - rays.mean(axis=0))  # two span the cameras' plane
        ring = np.argsort(np.arctan2(rays @ axes[1], rays @ axes[0]))
        ring = np.roll(ring, -int(rng.integers(len(names))))
        step = 1 if case.kind == "arc" else len(names) / count
        kept = ring[(np.arange(count) * step).astype(int)]
    few = scene.without(set(names) - {names[row] for row in kept})
    seen = np.zeros(len(scene.points), dtype=int)
    for image in few.images:
        seen[image.point_indices] += 1
    good = seen >= 2 if few.has_tracks else np.ones(len(seen), dtype=bool)
    rows = np.cumsum(good) - 1
    images = tuple(
        replace(image, point_indices=rows[image.point_indices[good[image.point_indices]]])
        for image in few.images
    )
    return replace(few, images=images, points=few.points[good], colors=few.colors[good])


def measured(case: Case, source: StudyScene, options: argparse.Namespace, context: Context) -> Path:
    """The record of a case; trains and evaluates the case unless the record exists."""
    folder: Path = options.out / case.name
    record = folder / run_files.REPORT_DATA
    if record.exists():
        return record
    cache = options.out / "cache"
    loaded = load_colmap(source.path, max_side=options.max_side, cache=cache)
    scene = with_exposures(loaded, cache, pixels=True, context=context)  # as training does
    rois = source.rois
    few = cut(scene, rois[0], case)
    config = preset(options.preset)
    if options.change:
        config = changed(config, parse_variant(f"x:{options.change}", options.preset).changes)
    config = config.scaled(options.steps)
    every = config.test_every if case.kind == "arc" else 0
    config = replace(config, test_every=every, seed=case.seed)
    run = define_run(folder, few, rois, config, context=context)
    open_folder(run, context)
    models = train_opened(run, ("full-scene-tuned",), context)
    whole = run.frame.scene(scene)
    kept = {image.name for image in few.images}
    photos = run.test or tuple(image.name for image in whole.images if image.name not in kept)
    evaluation = evaluate(models, whole, photos, run.rois, context=context)
    write_crops(evaluation, models, whole, run.rois, folder, context=context)
    write_report(evaluation, folder)
    return record


def line(case: Case, evaluation: Evaluation) -> list[str]:
    """The table's row of a case: means over its boxes, and the worst photo in any box."""
    ours, base, worst = [], [], {}
    for scores in evaluation.rois:
        rows = {row.model: row for row in scores.rows}
        mine, other = rows[OURS], rows[FULL_SCENE_TUNED]
        if mine.roi_psnr is None or other.roi_psnr is None:
            continue
        ours.append(mine.roi_psnr)
        base.append(other.roi_psnr)
        for view, before in zip(mine.views, other.views, strict=True):
            worst[f"{scores.roi} {view.view}"] = view.roi_psnr - before.roi_psnr
    if not ours:
        return [case.name, *["–"] * 5]
    name = min(worst, key=lambda key: worst[key])
    means = float(np.mean(ours)), float(np.mean(base))
    return [
        case.name,
        f"{means[1]:.2f}",
        f"{means[0]:.2f}",
        f"{means[0] - means[1]:+.2f}",
        f"{worst[name]:+.2f}",
        name,
    ]


HEAD = ("case", "tuned Full Scene, dB", "ours, dB", "gain", "worst photo", "which")


def main(arguments: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Measure missing cases, and print the table."""
    options = _options(sys.argv[1:] if arguments is None else arguments)
    if options.threads is not None:
        library.set_threads(options.threads)
    torch.set_num_threads(1)
    console = Console(json_lines=False, stop=stop)
    console.watch()
    context, rows = on_device(console.context, options.device), []
    with one_torch_thread():
        for source in parse_scenes(options.scenes):
            for seed in options.seeds:
                for kind in options.kinds:
                    for count in options.counts:
                        case = Case(scene=source.name, kind=kind, count=count, seed=seed)
                        record = read_json(measured(case, source, options, context))
                        rows.append(line(case, Evaluation.from_dict(record)))
                        console.print(" | ".join(rows[-1]))
    console.print("\n".join(table(HEAD, rows, names=1)))
    return 0


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.few_photos", description=__doc__)
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="[NAME=]PATH[:ROIS.json]")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--counts", type=int, nargs="+", default=[12, 16, 20, 24])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--steps", type=float, default=1.0, metavar="F")
    parser.add_argument("--max-side", type=int, default=640)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--device", choices=DEVICES, default="cpu")
    parser.add_argument("--change", metavar="FIELD=VALUE,...", help="other settings of the preset")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    run_process(lambda stop: main(stop=stop))
