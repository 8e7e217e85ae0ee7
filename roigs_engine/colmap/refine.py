"""Refines the cameras of a COLMAP model by its tracks alone: photos are not used.

COLMAP's usual camera, SIMPLE_RADIAL, has one focal length and one distortion parameter: too few
for many lenses. Its poses then lean to make up for the rest, by half a pixel and more, and no model
can be sharp in all photos. So the cameras get OPENCV's eight parameters, and a bundle adjustment
(Triggs et al. 2000) with a loss that ignores wrong matches (Cauchy's) finds cameras, poses and
points again. Of every third point, one observation is left out. The result is kept only if it fits
these better than the old cameras, adjusted without them with COLMAP's own loss.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..context import QUIET, Context
from ..errors import SceneError
from ..model.scene import Float64
from .library import pycolmap_module
from .model_files import HINT_DAMAGED, read_model

FULLER = "OPENCV"
# Models that OPENCV includes -> the places of fx, fy, cx, cy, k1, k2 among their parameters.
INCLUDED: dict[str, tuple[int | None, ...]] = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, None, None),
    "PINHOLE": (0, 1, 2, 3, None, None),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3, None),
    "RADIAL": (0, 0, 1, 2, 3, 4),
}
FEWEST_PHOTOS = 5  # of a camera that gets more parameters
FEWEST_OBSERVATIONS = 10  # of a photo whose camera may move: fewer could send it anywhere
LEFT_OUT_EVERY = 3  # points
LONG_TRACK = 4  # observations; of a shorter one, none can be left out
FEWEST_LEFT_OUT = 50  # observations to compare by
LOSS_SCALE = 1.0  # px of the full-size photos; what is farther off counts ever less
ITERATIONS = 20  # it settles in ten

Observation = tuple[int, int, int]
"""Ids of the photo, of its keypoint, and of the point."""


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """What a refinement did.

    Attributes:
        before, after: median error of the left-out observations with the old and the new cameras,
            px of the full-size photos.
        left_out: their number.
        cameras: number of cameras that got more parameters.
        better: whether the left-out observations fit better; only then anything was written.
    """

    before: float
    after: float
    left_out: int
    cameras: int

    @property
    def better(self) -> bool:
        """See the class."""
        return self.after < self.before


def refine_cameras(model: Path, out: Path, context: Context = QUIET) -> Refinement:
    """Refine the model in the folder `model`, and write the result to the folder `out`.

    The world stays where it is: a similarity carries the refined points onto the old ones, so boxes
    keep their place. The photos' names and the tracks do not change.

    Args:
        model: a folder with COLMAP's files.
        out: the new folder; nothing is written unless the result is better.
        context: receives progress; checked for cancellation between the adjustments.

    Raises:
        SceneError: the model is damaged or has too few tracks, or `out` is not empty.
        EngineError: pycolmap is not installed.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SceneError(f"{out} exists already.", "Give another --out, or remove it.")
    colmap = pycolmap_module("Refining cameras")
    # pycolmap may not return from a damaged model, and cuts names at spaces in text files
    names = {image.image_id: image.name for image in read_model(model, context).images}
    with _explained(model):
        return _refined(colmap, model, names, out, context)


def _refined(
    colmap: Any, model: Path, names: dict[int, str], out: Path, context: Context
) -> Refinement:
    scene, started = _read(colmap, model), time.monotonic()
    left_out = _left_out(scene)
    if len(left_out) < FEWEST_LEFT_OUT:
        raise SceneError(
            f"{model} has too few points that {LONG_TRACK} or more photos observe.",
            "Export the model with its observations, or take more photos.",
        )
    # The model as it is has seen the left-out observations: adjust it without them to compare.
    before = _adjusted(colmap, scene, left_out, "TRIVIAL")
    context.progress("refine cameras", 1, 2, started)
    context.check_cancelled()
    scene = _read(colmap, model)
    placed = {key: np.array(point.xyz) for key, point in scene.points3D.items()}
    cameras = _with_fuller_cameras(colmap, scene)
    after = _adjusted(colmap, scene, left_out, "CAUCHY")
    context.progress("refine cameras", 2, 2, started)
    context.check_cancelled()
    done = Refinement(before=before, after=after, left_out=len(left_out), cameras=cameras)
    if done.better:
        for image, keypoint, point in left_out:
            scene.add_observation(point, colmap.TrackElement(image, keypoint))
        _carry_back(colmap, scene, placed)
        for key, image in scene.images.items():
            image.name = names[key]
        _write(scene, out)
    return done


@contextmanager
def _explained(model: Path) -> Iterator[None]:
    """Turn pycolmap's errors about a model into one line."""
    try:
        yield
    except (ValueError, RuntimeError, IndexError, KeyError) as error:
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise SceneError(f"pycolmap cannot use {model} ({last}).", HINT_DAMAGED) from error


def _read(colmap: Any, model: Path) -> Any:
    """The model without points that have no position."""
    scene = colmap.Reconstruction(str(model))
    for key in scene.point3D_ids():
        if not np.isfinite(scene.points3D[key].xyz).all():
            scene.delete_point3D(key)
    return scene


def _write(scene: Any, out: Path) -> None:
    """Write all files, or none."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as folder:
            scene.write(folder)
            for path in Path(folder).iterdir():
                path.replace(out / path.name)
    except (OSError, ValueError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise SceneError(f"Cannot write {out} ({reason}).", "Give another --out.") from error


def _left_out(scene: Any) -> list[Observation]:
    """One observation of every third point with a long track."""
    found = []
    points = [point for point in sorted(scene.point3D_ids()) if _length(scene, point) >= LONG_TRACK]
    for number, point in enumerate(points[::LEFT_OUT_EVERY]):
        elements = scene.points3D[point].track.elements
        element = elements[number % len(elements)]
        found.append((element.image_id, element.point2D_idx, point))
    return found


def _length(scene: Any, point: int) -> int:
    return len(scene.points3D[point].track.elements)


def _with_fuller_cameras(colmap: Any, scene: Any) -> int:
    """Give the cameras that OPENCV includes its parameters, and return their number.

    A camera of few photos keeps its own: more could fit anything.
    """
    photos: dict[int, int] = {}
    for image in scene.images.values():
        photos[image.camera_id] = photos.get(image.camera_id, 0) + 1
    changed = 0
    for key, camera in scene.cameras.items():
        places = INCLUDED.get(camera.model.name)
        if places is None or photos.get(key, 0) < FEWEST_PHOTOS:
            continue
        old = camera.params
        values = [0.0 if place is None else float(old[place]) for place in places]
        camera.model = getattr(colmap.CameraModelId, FULLER)
        camera.params = [*values, 0.0, 0.0]
        changed += 1
    return changed


def _adjusted(colmap: Any, scene: Any, left_out: Sequence[Observation], loss: str) -> float:
    """Adjust the scene without the left-out observations; their median error then, px."""
    for image, keypoint, _ in left_out:
        scene.delete_observation(image, keypoint)
    options = colmap.BundleAdjustmentOptions()
    solver = getattr(options, "ceres", options)  # where pycolmap has these, since 4 and before
    options.print_summary = False
    solver.loss_function_type = getattr(colmap.LossFunctionType, loss)
    solver.loss_function_scale = LOSS_SCALE
    solver.solver_options.max_num_iterations = ITERATIONS
    config = colmap.BundleAdjustmentConfig()
    for image in scene.reg_image_ids():
        if scene.images[image].num_points3D >= FEWEST_OBSERVATIONS:
            config.add_image(image)
    colmap.create_default_bundle_adjuster(options, config, scene).solve()
    return float(np.median(_errors(scene, left_out)))


def _errors(scene: Any, observations: Sequence[Observation]) -> Float64:
    """(M,) distances of keypoints from where their points appear, px; infinite: nowhere."""
    errors = np.full(len(observations), np.inf)
    for row, (image, keypoint, point) in enumerate(observations):
        photo = scene.images[image]
        seen = photo.project_point(scene.points3D[point].xyz)
        if seen is not None:
            errors[row] = np.linalg.norm(photo.points2D[keypoint].xy - seen)
    return errors


def _carry_back(colmap: Any, scene: Any, placed: dict[int, Float64]) -> None:
    """Move the scene by the similarity that carries its points onto their old places.

    Wrong points may have moved far: the half that moved most is left out of the fit.
    """
    keys = [key for key in placed if scene.exists_point3D(key)]
    new = np.array([scene.points3D[key].xyz for key in keys])
    old = np.array([placed[key] for key in keys])
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
