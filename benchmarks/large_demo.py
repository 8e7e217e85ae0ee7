"""Against the large demo's truth: `python -m benchmarks.large_demo LARGE RUN ... --out DIR`.

LARGE is what demo/large_capture.py made, with its model and boxes. Each RUN is drawn from the
held-out views, whose cameras are the true ones, and compared with their pictures: without blur, at
the exposure in the middle of the photos'. `--photos` names the photos that the runs were trained
on. DIR gets report.md and report.json; the table is printed. A capture of which only a part is
rendered has a part of the views.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from benchmarks.guidance.arms import true_pose
from benchmarks.markdown import table
from roigs_engine.app.inputs import load_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.console import Console
from roigs_engine.commands.process import run_process
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.report import write_report
from roigs_engine.evaluation.scores import Evaluation
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats import run_files
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.roi import load_rois
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.photos.headers import content_digest

HELD_OUT = "held_out/"
COLUMNS = ("roi_psnr", "corrected_psnr", "object_psnr", "roi_ssim", "image_psnr")
HEAD = ("box", "run", "box (dB)", "colour-fitted", "object", "SSIM", "whole image", "Gaussians")


def held_out_photos(large: Path, photos: str, max_side: int) -> list[PosedImage]:
    """The rendered held-out views, with the true cameras, resized to `max_side`."""
    truth = json.loads((large / "truth.json").read_text())
    width, height, focal = truth["width"], truth["height"], truth["focal"]
    lens = Camera(
        width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2
    ).thumbnail(max_side)
    found = []
    for name, known in truth["photos"].items():
        path = (large / f"{photos}_held_out" / name.removeprefix(HELD_OUT)).with_suffix(".png")
        if not name.startswith(HELD_OUT) or not path.exists():
            continue
        digest = content_digest(path)
        found.append(
            PosedImage(
                name=name,
                path=path,
                camera=lens,
                world_to_camera=true_pose(known),
                digest=digest,
                file_digest=digest,
            )
        )
    return found


def scored(
    large: Path, photos: str, runs: Sequence[Path], max_side: int, console: Console
) -> Evaluation:
    """Evaluate the runs' results on the held-out views."""
    scene = load_colmap(large)
    frame = LocalFrame.of_scene(scene)
    views = held_out_photos(large, photos, max_side)
    whole: SfmScene = replace(scene, images=(*scene.images, *views), has_tracks=False)
    models = [
        EvaluatedModel(
            name=run.name,
            gaussians=load_model(run / run_files.RESULT, frame, console.context),
            seconds=0.0,
        )
        for run in runs
    ]
    boxes = [frame.box(box) for box in load_rois(large / "rois.json")]
    names = [view.name for view in views]
    return evaluate(
        models, frame.scene(whole), names, boxes, context=console.context, baseline=runs[0].name
    )


def lines(evaluation: Evaluation) -> list[list[str]]:
    """Rows of the table, by box."""
    rows = []
    for scores in evaluation.rois:
        for row in scores.rows:
            values = (getattr(row, name) for name in COLUMNS)
            digits = (3 if name == "roi_ssim" else 2 for name in COLUMNS)
            numbers = [
                "" if value is None else f"{value:.{places}f}"
                for value, places in zip(values, digits, strict=True)
            ]
            rows.append([scores.roi, row.model, *numbers, f"{row.gaussians:,}"])
    return rows


def main(arguments: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Measure the runs, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.large_demo", description=__doc__)
    parser.add_argument("large", type=Path)
    parser.add_argument("runs", type=Path, nargs="+", help="run folders; the first: the baseline")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--photos", default="images", help="folder of the photos, in LARGE")
    parser.add_argument("--max-side", type=int, default=640, help="of the pictures, in pixels")
    args = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    torch.set_num_threads(1)
    console = Console(json_lines=False, stop=stop)
    console.watch()
    evaluation = scored(args.large, args.photos, args.runs, args.max_side, console)
    args.out.mkdir(parents=True, exist_ok=True)
    write_report(evaluation, args.out)
    console.print("\n".join(table(HEAD, lines(evaluation), names=2)))
    return 0


if __name__ == "__main__":
    run_process(lambda stop: main(stop=stop))
