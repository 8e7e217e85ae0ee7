"""How far the cameras of COLMAP models are off: `python -m benchmarks.camera_errors MODEL ...`.

For scenes whose true cameras are known, such as the demo (`truth.json`). Places in each object's
box are projected with the true cameras; from these pixels, MODEL's cameras find the places again.
How far they then appear from the true pixels, mean over a photo's places, is the error of the
photo's camera there. That a model is turned, moved or scaled as a whole makes no difference: nor
does it in training.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.markdown import table
from roigs_engine.cli import exit_status_of
from roigs_engine.colmap.library import pycolmap_module
from roigs_engine.commands.console import Console
from roigs_engine.model.scene import Float64

PLACES = 3  # along each side of a box
NEAREST = 1 / 3  # of the photos


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.camera_errors", description=__doc__)
    parser.add_argument("models", nargs="+", type=Path, metavar="MODEL")
    parser.add_argument("--truth", type=Path, default=Path("demo/scene/truth.json"))
    options = parser.parse_args(arguments)
    console = Console(json_lines=False)

    def work() -> int:
        truth = json.loads(options.truth.read_text(encoding="utf-8"))
        rows = [row for model in options.models for row in _rows(model, truth)]
        head = ["model", "box", "photos", "rms, px", "median", "near, median", "near, largest"]
        console.print("\n".join(table(head, rows, names=2)))
        return 0

    return exit_status_of(work, console, "camera_errors")


def _rows(model: Path, truth: dict[str, Any]) -> list[list[str]]:
    scene = pycolmap_module("Reading cameras").Reconstruction(str(model))
    images = {image.name: image for image in scene.images.values()}
    rows = []
    for name, box in truth["objects"].items():
        errors, sizes = _errors(images, _places(box), truth)
        near = errors[sizes >= np.quantile(sizes, 1 - NEAREST)]
        numbers = (np.sqrt((errors**2).mean()), np.median(errors), np.median(near), near.max())
        rows.append([str(model), name, str(len(errors)), *(f"{number:.3f}" for number in numbers)])
    return rows


def _places(box: dict[str, list[float]]) -> Float64:
    """(P, 3) places spread over a box."""
    sides = [np.linspace(a, b, PLACES) for a, b in zip(box["min"], box["max"], strict=True)]
    places: Float64 = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return places


def _errors(
    images: dict[str, Any], places: Float64, truth: dict[str, Any]
) -> tuple[Float64, Float64]:
    """(V,) errors of the photos that show any place, px; and pixels per unit of length there."""
    true = {name: _seen(truth, name, places) for name in images}
    missed: dict[str, list[Float64]] = {}
    for row in range(len(places)):
        seen = {
            name: found[row] for name, (found, _) in true.items() if np.isfinite(found[row]).all()
        }
        if len(seen) < 2:
            continue
        for name, miss in zip(seen, _misses(images, seen), strict=True):
            missed.setdefault(name, []).append(miss)
    errors = [np.linalg.norm(np.mean(own, axis=0)) for own in missed.values()]
    return np.array(errors), np.array([true[name][1] for name in missed])


def _seen(truth: dict[str, Any], name: str, places: Float64) -> tuple[Float64, float]:
    """(P, 2) where the true camera shows the places, NaN: not; and pixels per unit there."""
    photo, size = truth["photos"][name], np.array([truth["width"], truth["height"]])
    local = (places - photo["centre"]) @ np.array(photo["rotation"])
    found = local[:, :2] / local[:, 2:] * truth["focal"] + size / 2
    shown = (local[:, 2] > 0) & (found > 0).all(axis=1) & (found < size).all(axis=1)
    return np.where(shown[:, None], found, np.nan), truth["focal"] / local[:, 2].mean()


def _misses(images: dict[str, Any], seen: dict[str, Float64]) -> Float64:
    """(V, 2) how far from the true pixels the place appears that fits them best, px."""
    equations = []
    for name, pixel in seen.items():
        matrix = np.asarray(images[name].cam_from_world().matrix())
        ray = np.asarray(images[name].camera.cam_from_img(pixel[None]))[0]
        equations += [ray[k] * matrix[2] - matrix[k] for k in range(2)]
    start = np.linalg.svd(np.array(equations))[2][-1]

    def misses(place: Float64) -> Float64:
        found = [images[name].project_point(place) for name in seen]
        return np.ravel(np.array(found) - list(seen.values()))

    return misses(least_squares(misses, start[:3] / start[3], loss="soft_l1").x).reshape(-1, 2)


if __name__ == "__main__":
    raise SystemExit(main())
