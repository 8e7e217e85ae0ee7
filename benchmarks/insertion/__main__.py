"""The command: the truth's pictures, and the table of rows; see the README of benchmarks."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from benchmarks.markdown import table
from roigs_engine.formats import run_files

from .views import LAMP, MEASURES, ROWS, means, measured, photos_that_show_most

TRUE_ROOM = Path(__file__).resolve().parents[2] / "demo/inserted.py"


def make_truth(given: argparse.Namespace) -> None:
    """Render what is missing of the truth, in a separate process, which needs `bpy`."""
    photos = _test_photos(given.run)
    command = [sys.executable, str(TRUE_ROOM), str(given.out.resolve())]
    command += ["--width", str(given.width), "--samples", str(given.samples), "--photos"]
    subprocess.run([*command, *photos, "--states"], check=True)  # which things each photo shows
    subprocess.run([*command, *photos_that_show_most(given.out, photos)], check=True)


def make_ours(given: argparse.Namespace) -> None:
    """Render what is missing of the rows, each in a separate process, which needs `bpy`."""
    photos = photos_that_show_most(given.truth, _test_photos(given.run))[: given.views]
    for row in given.rows or (*ROWS, LAMP):
        command = [str(given.bpy), "-m", "benchmarks.insertion.ours", str(given.run.resolve())]
        command += ["--engine-python", sys.executable]
        command += [str((given.out / row).resolve()), "--samples", str(given.samples)]
        command += ["--row", ROWS[-1], "--lamp"] if row == LAMP else ["--row", row]
        subprocess.run([*command, "--photos", *photos], check=True)


def show_scores(given: argparse.Namespace) -> None:
    """Print a row for each folder of pictures, means over the photos."""
    photos = photos_that_show_most(given.truth, _test_photos(given.run))
    rows, every = [], {}
    for text in given.row:
        name, _, folder = text.partition("=")
        views = [measured(Path(folder), given.truth, photo) for photo in photos]
        rows.append([name, *_cells(means(views))])
        every[name] = {view.photo: view.found for view in views}
        if given.views:
            rows += [[f"{name}, {view.photo}", *_cells(view.found)] for view in views]
    print("\n".join(table(("row", *MEASURES), rows, names=1)))
    if given.out:
        given.out.write_text(json.dumps(every, indent=1), "utf-8")


def _cells(found: dict[str, float]) -> list[str]:
    return [f"{found[name]:.2f}" if name in found else "" for name in MEASURES]


def _test_photos(run: Path) -> list[str]:
    names: list[str] = json.loads((run / run_files.SPLIT).read_text("utf-8"))["test"]
    return names


def main() -> None:
    """Make the truth, or print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parts = parser.add_subparsers(required=True)
    truth = parts.add_parser("truth", help="render the true room; needs bpy")
    truth.add_argument("run", type=Path, help="run of the demo, whose test photos are rendered")
    truth.add_argument("out", type=Path, help="folder of the truth; what it has is kept")
    truth.add_argument("--width", type=int, default=320, help="pixels")
    truth.add_argument("--samples", type=int, default=64, help="of a pixel, before the denoiser")
    truth.set_defaults(function=make_truth)
    ours = parts.add_parser("ours", help="render the captured scene with the things; needs bpy")
    ours.add_argument("run", type=Path, help="the run; it gets a mesh of the background")
    ours.add_argument("truth", type=Path, help="folder of the truth")
    ours.add_argument("out", type=Path, help="folder of the rows; what they have is kept")
    ours.add_argument("--rows", nargs="*", choices=(*ROWS, LAMP), help="default: all")
    ours.add_argument("--views", type=int, help="so many photos; default: those of the truth")
    ours.add_argument("--samples", type=int, default=32, help="of a pixel, before the denoiser")
    ours.add_argument(
        "--bpy", type=Path, default=sys.executable, help="a Python with bpy; default: this one"
    )
    ours.set_defaults(function=make_ours)
    score = parts.add_parser("score", help="compare folders of pictures with the truth")
    score.add_argument("run", type=Path, help="the run")
    score.add_argument("truth", type=Path, help="folder of the truth")
    score.add_argument("--row", action="append", default=[], metavar="NAME=FOLDER")
    score.add_argument("--views", action="store_true", help="a row for each photo, too")
    score.add_argument("--out", type=Path, help="JSON of all measures")
    score.set_defaults(function=show_scores)
    given = parser.parse_args()
    given.function(given)


if __name__ == "__main__":
    main()
