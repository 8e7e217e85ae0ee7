"""From bare photos to trained boxes: `python -m benchmarks.end_to_end SCENE --out DIR`.

Runs `reconstruct` on SCENE/images, `refine-cameras` and `train`, and prints the seconds of each
stage. SCENE's own model is used only to carry its boxes into the new one. See README.md.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.from_photos import boxes_for, registered
from benchmarks.markdown import table
from roigs_engine.formats.files import write_json

REFINED = Path("sparse/refined")  # in the project: the model that `refine-cameras` writes


def timed(words: Sequence[Any]) -> dict[str, float]:
    """Stage of a command -> seconds, in order; `rest` is the time outside of stages."""
    command = [sys.executable, "-m", "roigs_engine", *map(str, words), "--events"]
    seconds, stage, last = {"rest": 0.0}, "rest", time.monotonic()

    def until_now() -> None:
        nonlocal last
        now = time.monotonic()
        seconds[stage] = seconds.get(stage, 0.0) + now - last
        last = now

    pipe = subprocess.PIPE  # without an open standard input, the command would stop
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as child:
        assert child.stdout is not None
        for line in child.stdout:
            event = json.loads(line)
            if event["event"] == "stagestarted":
                until_now()
                stage = event["stage"]
            elif event["event"] == "progress" and event["step"] >= event["total"]:
                until_now()
                stage = "rest"
            elif event["event"] == "progress" and stage == "rest":
                stage = event["stage"]
    until_now()
    if child.returncode:
        raise SystemExit(f"{words[0]} failed ({child.returncode}).")
    rest = seconds.pop("rest")
    return {**seconds, "rest": rest}


def measure(scene: Path, out: Path, training: Sequence[Any]) -> dict[str, dict[str, float]]:
    """Measure one run that starts from photos; returns command -> stage -> seconds."""
    project, boxes, run = out / "project", out / "rois.json", out / "run"
    for folder in (project, run):
        shutil.rmtree(folder, ignore_errors=True)
    found = {"reconstruct": timed(["reconstruct", scene / "images", "--out", project])}
    found["refine-cameras"] = timed(["refine-cameras", project])
    write_json(boxes, {"rois": boxes_for(scene, registered(scene), registered(project))})
    model = project / REFINED
    images = ("--images", project / "images")
    given = model if model.is_dir() else project  # without it, the cameras were already good
    words = ["train", given, *images, "--rois", boxes, "--run-dir", run, "--test-every", 0]
    found["train"] = timed([*words, *training])
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", type=Path, help="folder with images, sparse/0 and rois.json")
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--runs", type=int, default=2, help="how often all is done (2)")
    parser.add_argument("--preset", default="standard", help="of the training")
    parser.add_argument("--max-side", type=int, default=640, help="photos in training, px")
    given = parser.parse_args(arguments)
    training = ["--preset", given.preset, "--max-side", given.max_side]
    runs = []
    for number in range(given.runs):
        folder = given.out / f"run-{number}"
        folder.mkdir(parents=True, exist_ok=True)
        runs.append(measure(given.scene, folder, training))
        write_json(given.out / "seconds.json", {"cores": os.cpu_count(), "runs": runs})
    rows = []
    for command, stages in runs[0].items():
        for stage in stages:
            times = [f"{run[command].get(stage, 0.0):.0f}" for run in runs]
            rows.append([command, stage, *times])
        rows.append([command, "**all**", *(f"{sum(run[command].values()):.0f}" for run in runs)])
    total = [f"**{sum(sum(c.values()) for c in run.values()):.0f}**" for run in runs]
    rows.append(["**all**", "", *total])
    head = ("command", "stage", *(f"run {number}, s" for number in range(given.runs)))
    print("\n".join(table(head, rows, names=2)))


if __name__ == "__main__":
    main()
