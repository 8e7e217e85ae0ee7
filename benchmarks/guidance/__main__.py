"""Gain of the guide: `python -m benchmarks.guidance --out DIR`; see benchmarks/README.md.

From some of the demo's photos, the guide proposes photos of each object; they are rendered from
there and trained with, against random and even photos from the same shell. All models are scored
on the same true photos, near and far. What is in DIR already is not made again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean

import torch

from benchmarks.guidance.arms import ARMS, planned, start_of, true_capture, with_photos
from benchmarks.guidance.photographer import HEIGHT, TESTS, VALIDATION, WIDTH
from benchmarks.markdown import table
from roigs_engine.app.inputs import load_model, on_device
from roigs_engine.commands.console import Console
from roigs_engine.commands.process import run_process
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.context import Context
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.report import write_report
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats import run_files
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.model.roi import OrientedBox, load_rois
from roigs_engine.model.scene import Camera, SfmScene
from roigs_engine.run.definition import define_run
from roigs_engine.run.folder import open_folder, train_opened
from roigs_engine.run.presets import preset
from roigs_engine.training.loop import one_torch_thread

DEMO = Path(__file__).resolve().parents[2] / "demo" / "scene"
START = "start"
FOCAL = 28 / 36 * WIDTH
LENS = Camera(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=WIDTH / 2, cy=HEIGHT / 2)
SETS = {"test": (1001, TESTS), "validation": (2001, VALIDATION)}
HEAD = ("draw", "box", "photos", "object PSNR (dB)", "near", "far", "over even", "over random")


def render(folder: Path, *more: str) -> None:
    """Render what a folder's list asks for, in a separate process."""
    words = [sys.executable, "-m", "benchmarks.guidance.photographer", str(folder), *more]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def trained(
    folder: Path, scene: SfmScene, boxes: Sequence[OrientedBox], args: argparse.Namespace,
    seed: int, context: Context,
) -> Path:  # fmt: skip
    """The result of a training on all photos of a scene; trained now unless it is there."""
    result = folder / run_files.RESULT
    if not result.exists():
        config = preset("draft").scaled(args.steps)
        config = replace(config, test_every=0, seed=seed)
        run = define_run(folder, scene, boxes, config, context=context)
        open_folder(run, context)
        train_opened(run, (), context)
    return result


def scored(
    folder: Path, results: dict[str, Path], scene: SfmScene, boxes: Sequence[OrientedBox],
    tests: Sequence[str], context: Context,
) -> dict[str, dict[str, dict[str, float | None]]]:  # fmt: skip
    """Box -> arm -> photo -> object PSNR; the objects' masks are the same for all arms."""
    from roigs_engine.model.local_frame import LocalFrame

    frame = LocalFrame.of_scene(scene)
    local = [frame.box(box) for box in boxes]
    models = [
        EvaluatedModel(name=arm, gaussians=load_model(path, frame, context), seconds=0.0)
        for arm, path in results.items()
    ]
    evaluation = evaluate(models, frame.scene(scene), tests, local, context=context, baseline=START)
    folder.mkdir(parents=True, exist_ok=True)
    write_report(evaluation, folder)
    return {
        scores.roi: {
            row.model: {view.view: view.object_psnr for view in row.views} for row in scores.rows
        }
        for scores in evaluation.rois
    }


def lines(draw: int, scores: dict[str, dict[str, dict[str, float | None]]]) -> list[list[str]]:
    """Rows of the table of a draw."""
    rows = []
    for box, arms in scores.items():
        means = {arm: averages(box, views) for arm, views in arms.items()}
        for arm, (whole, near, far) in means.items():
            over = [
                f"{whole - means[other][0]:+.2f}" if other in means and arm == "guide" else ""
                for other in ("even", "random")
            ]
            numbers = [f"{value:.2f}" for value in (whole, near, far)]
            rows.append([str(draw), box, arm, *numbers, *over])
    return rows


def averages(box: str, views: dict[str, float | None]) -> tuple[float, float, float]:
    """Mean object PSNR of the box's own photos, of their nearer half and of the farther one.

    Photos of a box are numbered by distance; one that shows too little of it has no number.
    """
    own = [views[name] for name in sorted(views) if Path(name).name.startswith(f"{box}_")]
    half = len(own) // 2
    parts = own, own[:half], own[half:]
    whole, near, far = (mean(v for v in part if v is not None) for part in parts)
    return whole, near, far


def main(arguments: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Measure what is missing, and print the table."""
    args = _options(sys.argv[1:] if arguments is None else arguments)
    torch.set_num_threads(1)
    console = Console(json_lines=False, stop=stop)
    console.watch()
    context, rows = on_device(console.context, "cpu"), []
    boxes = [box for box in load_rois(DEMO / "rois.json") if box.name in args.boxes]
    capture = true_capture(DEMO, WIDTH)
    truth = args.out / "truth" / args.photos
    seed, count = SETS[args.photos]
    render(truth, "--seed", str(seed), "--count", str(count))
    for draw in args.draws:
        folder = args.out / f"draw-{draw}"
        start = start_of(capture, boxes[0], args.start, draw)
        scenes = {START: start}
        for arm in args.arms:
            shots = folder / arm / "shots.json"
            if not shots.exists():
                write_json(shots, planned(start, boxes, arm, args.count, draw))
            render(folder / arm)
            scenes[arm] = with_photos(start, folder / arm, LENS, "more")
        results = {}
        with one_torch_thread():
            for arm, scene in scenes.items():
                results[arm] = trained(folder / f"{arm}-run", scene, boxes, args, draw, context)
            whole = with_photos(start, truth, LENS, "truth")
            tests = [image.name for image in whole.images if image.name.startswith("truth/")]
            record = folder / f"{args.photos}.json"
            known = read_json(record) if record.exists() else {}
            if not all(set(results) <= set(arms) for arms in known.values()) or not known:
                place = folder / f"{args.photos}-report"
                known = scored(place, results, whole, boxes, tests, context)
                write_json(record, known)
        rows += lines(draw, known)
    console.print("\n".join(table(HEAD, rows, names=3)))
    return 0


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.guidance", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--draws", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--boxes", nargs="+", default=["vase", "tin", "clock"])
    parser.add_argument("--start", type=int, default=40, help="photos at the beginning")
    parser.add_argument("--count", type=int, default=8, help="photos added of each box")
    parser.add_argument("--steps", type=float, default=1.0, metavar="F", help="of the preset")
    parser.add_argument("--photos", choices=tuple(SETS), default="test")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    run_process(lambda stop: main(stop=stop))
