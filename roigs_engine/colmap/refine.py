"""Refines the cameras of a COLMAP model by its tracks, then by its photos.

Cameras get OPENCV's eight parameters, and a bundle adjustment (Triggs et al. 2000) with Cauchy's
loss. The result is kept only if it fits left-out observations better than the old cameras do. For
this, the old cameras are adjusted without these observations, with COLMAP's own loss. Then cameras
are fitted to points that are located in the photos (`refine_by_matches`). docs/method.md,
"Cameras", has the reasons.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.scratch import scratch
from ..model.scene import Float64
from ..photos.files import find_photos
from . import adjustment
from .library import pycolmap_module
from .model_files import HINT_DAMAGED, pycolmap_model, read_model
from .project import model_turns
from .refine_by_matches import MatchedFit, fit_to_matches, photo_files

LOSS_SCALE = 1.0  # px of the full-size photos; larger errors get less weight


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """The result of a refinement.

    Attributes:
        before, after: median error of the left-out observations with the old and the new cameras,
            px of the full-size photos.
        left_out: their number.
        cameras: number of cameras that got more parameters.
        matched: the fit to the photos; None: not done, or fewer than two usable photos.
    """

    before: float
    after: float
    left_out: int
    cameras: int
    matched: MatchedFit | None = None

    @property
    def fits_tracks_better(self) -> bool:
        """Whether the left-out observations fit the new cameras better."""
        return self.after < self.before

    @property
    def better(self) -> bool:
        """Whether cameras changed; only then are files written."""
        return self.fits_tracks_better or (self.matched is not None and self.matched.better)


def refine_cameras(
    model: Path,
    out: Path,
    context: Context = QUIET,
    *,
    images: Path | None = None,
    look: bool = True,
) -> Refinement:
    """Refine the model in the folder `model`, and write the result to the new folder `out`.

    The frame does not change: a similarity moves the refined points onto the old ones, so boxes
    stay in place. The photos' names and the tracks do not change. Nothing is written unless the
    result is better.

    Args:
        images: the photos' folder; None: the project's.
        look: whether to use the photos, too; without any, only the tracks are used.

    Raises:
        SceneError: the model is damaged or has too few tracks, or `out` is not empty, or `images`
            is no folder.
        EngineError: pycolmap is not installed.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SceneError(f"{out} exists already.", "Give another --out, or remove it.")
    colmap = pycolmap_module("Refining cameras")
    # On a damaged model, pycolmap may not return. In text files, it cuts names at spaces.
    with _explained(model):
        record, scene = pycolmap_model(colmap, model, context)
    names = {image.image_id: image.name for image in record.images}
    folder = find_photos(model, images, list(names.values())) if look else None
    with _explained(model):
        positions = {key: np.array(point.xyz) for key, point in scene.points3D.items()}
        fitted, done = _by_tracks(colmap, adjustment.thinned(colmap, scene), model, context)
        if folder is not None:
            turns = model_turns(record, model, folder, context)
            files = photo_files(scene, folder, names, turns, context)
            if sum(file is not None for file in files) < 2:
                context.info(
                    f"Fewer than two photos of {folder.folder} are usable: only the tracks are "
                    "used."
                )
            else:
                fitted, matched = fit_to_matches(colmap, fitted, files, context)
                done = replace(done, matched=matched)
        if done.better:
            scene = adjustment.with_cameras_of(colmap, scene, fitted, LOSS_SCALE)
            _carry_back(colmap, scene, positions)
            for key, image in scene.images.items():
                image.name = names[key]
            _write(scene, out)
    return done


def _by_tracks(colmap: Any, scene: Any, model: Path, context: Context) -> tuple[Any, Refinement]:
    """Fit cameras to the tracks; return the scene with the better cameras, new or old."""
    started, left_out = time.monotonic(), adjustment.to_leave_out(scene)
    if len(left_out) < adjustment.FEWEST_LEFT_OUT:
        raise SceneError(
            f"{model} has too few points observed by {adjustment.LONG_TRACK} or more photos.",
            "Export the model with its observations, or take more photos.",
        )
    # The given model was fitted to the left-out observations: adjust it without them to compare.
    old, new = colmap.Reconstruction(scene), colmap.Reconstruction(scene)
    for image, keypoint, _ in left_out:
        old.delete_observation(image, keypoint)
        new.delete_observation(image, keypoint)
    adjustment.adjust(colmap, old, "TRIVIAL", LOSS_SCALE)
    before = adjustment.median_error(old, left_out)
    context.progress("refine cameras", 1, 2, started)
    context.check_cancelled()
    cameras = adjustment.with_fuller_cameras(colmap, new)
    adjustment.adjust(colmap, new, "CAUCHY", LOSS_SCALE)
    after = adjustment.median_error(new, left_out)
    context.progress("refine cameras", 2, 2, started)
    context.check_cancelled()
    done = Refinement(before=before, after=after, left_out=len(left_out), cameras=cameras)
    if not done.fits_tracks_better:
        return scene, done
    for image, keypoint, point in left_out:
        new.add_observation(point, colmap.TrackElement(image, keypoint))
    return new, done


@contextmanager
def _explained(model: Path) -> Iterator[None]:
    """Turn pycolmap's errors about a model into a SceneError of one line."""
    try:
        yield
    except (ValueError, RuntimeError, IndexError, KeyError) as error:
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise SceneError(f"pycolmap cannot use {model} ({last}).", HINT_DAMAGED) from error


def _write(scene: Any, out: Path) -> None:
    """Write all files of the model, or none."""
    try:
        out = Path(os.path.realpath(out))  # the user may name a link
        out.parent.mkdir(parents=True, exist_ok=True)
        with scratch(f".{out.name}-", out.parent) as folder:
            model = folder / "model"
            model.mkdir()
            scene.write(str(model))
            # pycolmap does not report a full disk
            counts = (scene.num_reg_images(), scene.num_points3D())
            if _counts(model) != counts:
                raise SceneError(
                    f"Cannot write {out}: its files came out too short.",
                    "Free some space on the disk.",
                )
            with suppress(FileNotFoundError):
                out.rmdir()  # the folder is empty
            model.rename(out)
    except (OSError, ValueError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise SceneError(f"Cannot write {out} ({reason}).", "Give another --out.") from error


def _counts(model: Path) -> tuple[int, int] | None:
    """The numbers of photos and points of a model; None if it is damaged."""
    with suppress(SceneError):
        written = read_model(model)
        return len(written.images), len(written.point_ids)
    return None


def _carry_back(colmap: Any, scene: Any, positions: dict[int, Float64]) -> None:
    """Move the scene by the similarity that best maps its points to their old positions.

    Wrong points may have moved far, so the half that moved most is left out of the fit.
    """
    keys = [key for key in positions if scene.exists_point3D(key)]
    new = np.array([scene.points3D[key].xyz for key in keys])
    old = np.array([positions[key] for key in keys])
    kept = np.ones(len(keys), dtype=bool)
    for _ in range(2):
        similarity = colmap.estimate_sim3d(new[kept], old[kept])
        if similarity is None:
            raise SceneError("The refined cameras do not fit the model's frame.", HINT_DAMAGED)
        matrix = np.asarray(similarity.matrix())
        moved = new @ matrix[:3, :3].T + matrix[:3, 3]
        distance = np.linalg.norm(moved - old, axis=1)
        kept = distance <= np.median(distance)
    scene.transform(similarity)
