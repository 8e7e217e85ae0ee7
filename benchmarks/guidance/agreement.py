"""Whether the map tells where a model is wrong: `python -m benchmarks.guidance.agreement RUN`.

RUN is a finished run with test photos. Each patch of a box that a test photo shows has an error,
the mean squared one around it, and predictions from the training photos alone. The table has the
rank correlation (Spearman) of the error and each prediction, over all pairs of patch and photo.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.stats import spearmanr

from benchmarks.markdown import table
from roigs_engine.app.inputs import load_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET
from roigs_engine.formats import run_files
from roigs_engine.formats.files import read_json
from roigs_engine.guidance.box_map import SPACING, BoxMap, sees
from roigs_engine.guidance.known import known_box
from roigs_engine.guidance.photo_quality import PhotoQuality
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.roi import load_rois
from roigs_engine.model.scene import Float64, PosedImage, SfmScene, project
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize.view import render_view

WINDOW = 9  # pixels around a patch
HEAD = ("box", "pairs", "known", "known as finely", "texture", "both", "pixels", "angle")


def correlations(
    scene: SfmScene, found: BoxMap, quality: PhotoQuality, errors: dict[str, Float64]
) -> tuple[int, list[float]]:
    """Number of pairs, and Spearman's rho of error and each prediction of `HEAD`.

    Args:
        scene: all photos.
        errors: test photo -> (P,) error of each patch, NaN where it does not show it.
    """
    wrong, predictions = [], []
    for name, error in errors.items():
        rows = np.flatnonzero(np.isfinite(error) & np.isfinite(quality.texture))
        wrong.append(error[rows])
        predictions.append(_predicted(scene.image(name), found, quality.texture)[:, rows])
    joined = np.concatenate(predictions, axis=1)
    return joined.shape[1], [rank_correlation(p, np.concatenate(wrong)) for p in joined]


def rank_correlation(a: Float64, b: Float64) -> float:
    """Spearman's rho."""
    return float(spearmanr(a, b).statistic)


def _predicted(image: PosedImage, found: BoxMap, texture: Float64) -> Float64:
    """(6, P) predicted errors of the patches in a photo.

    What is known as finely as the photo shows it is measured by its pixels instead of rho*.
    """
    ways = _ways(image, found)
    depth = np.maximum(image.local(found.patches.places)[:, 2], 1e-12)
    own_density = np.sqrt(image.camera.fx * image.camera.fy) / depth / found.reference
    total, finest = np.zeros(len(ways)), np.zeros(len(ways))
    nearest = np.full(len(ways), np.pi)
    for column, photo in enumerate(found.images):
        own = _ways(photo, found)
        density = found.density[:, column] * found.sharpness[column] / found.reference
        cosine = (own * found.patches.normals).sum(axis=1).clip(0, 1)
        angle = np.arccos(np.clip((own * ways).sum(axis=1), -1, 1))
        total += density**2 * cosine * np.exp(-(angle**2) / (2 * SPACING**2))
        nearest = np.where(density > 0, np.minimum(nearest, angle), nearest)
        finest = np.maximum(finest, density)
    here = 1 / (1 + total / own_density**2)
    return np.stack([1 / (1 + total), here, texture, np.exp(texture) * here, -finest, nearest])


def _ways(image: PosedImage, found: BoxMap) -> Float64:
    """(P, 3) unit vectors from the patches to a camera."""
    ways = image.centre - found.patches.places
    return np.asarray(ways / np.linalg.norm(ways, axis=1)[:, None])


def _errors(image: PosedImage, shown: NDArray[np.float32], found: BoxMap) -> Float64:
    """(P,) mean squared error around each patch that a photo shows, else NaN."""
    photo = load_photo(image).astype(np.float32) / 255
    error = uniform_filter(((shown - photo) ** 2).mean(axis=2), WINDOW)
    seen, _, _ = sees(found.patches, found.space, image.camera, image.world_to_camera)
    pixels, _, _ = project(found.patches.places, image.camera, image.world_to_camera)
    result = np.full(len(seen), np.nan)
    column, row = pixels[seen].astype(int).T
    result[seen] = error[row, column]
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of a run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("rois", type=Path)
    parser.add_argument("--max-side", type=int, default=640)
    args = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    scene = load_colmap(args.scene, max_side=args.max_side, cache=args.run / "cache")
    tests = read_json(args.run / run_files.SPLIT)["test"]
    frame, train = LocalFrame.of_scene(scene), scene.without(tests)
    model = load_model(args.run / run_files.RESULT, frame, QUIET)
    shown = {
        name: render_view(
            model, scene.image(name).camera, frame.transform(scene.image(name).world_to_camera)
        ).image.numpy()
        for name in tests
    }
    rows = []
    for roi in load_rois(args.rois):
        known = known_box(train, roi)
        assert known.quality is not None
        errors = {name: _errors(scene.image(name), shown[name], known.map) for name in tests}
        pairs, found = correlations(scene, known.map, known.quality, errors)
        rows.append([roi.name, f"{pairs:,}", *(f"{value:+.2f}" for value in found)])
    print("\n".join(table(HEAD, rows, names=1)))


if __name__ == "__main__":
    main()
