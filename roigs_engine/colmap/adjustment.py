"""Bundle adjustments (Triggs et al. 2000) with pycolmap, their errors, and fuller lens models."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..formats.scratch import scratch
from .records import PARAMETER_COUNT

Observation = tuple[int, int, int]
"""Ids of the photo, of its keypoint, and of the point."""

FEWEST_OBSERVATIONS = 10  # for a photo whose camera may move; fewer do not determine it
LEFT_OUT_EVERY = 3  # every third point has an observation left out
FEWEST_LEFT_OUT = 50  # observations for a comparison
LONG_TRACK = 4  # observations; shorter tracks need all of theirs
ENOUGH = 500  # points in a photo: more take time, but hardly improve its camera
ITERATIONS, SETTLED = 20, 1e-5  # at most; relative fall of the cost at which it stops


def adjust(
    colmap: Any,
    scene: Any,
    loss: str,
    scale: float,
    *,
    points_only: bool = False,
    distortion: bool = True,
) -> None:
    """Find the cameras, poses and points that fit the tracks of `scene` best; changes it.

    Args:
        scene: pycolmap's reconstruction.
        loss, scale: pycolmap's name of the loss; the error in px from which it reduces weights.
        points_only: leave cameras and poses as they are.
        distortion: whether the lenses' distortion may change.
    """
    options = colmap.BundleAdjustmentOptions()
    solver = getattr(options, "ceres", options)  # since pycolmap 4, they are in `ceres`
    options.print_summary = False
    solver.loss_function_type = getattr(colmap.LossFunctionType, loss)
    solver.loss_function_scale = scale
    solver.solver_options.max_num_iterations = ITERATIONS
    solver.solver_options.function_tolerance = SETTLED
    options.refine_focal_length = options.refine_sensor_from_rig = not points_only
    options.refine_extra_params = distortion and not points_only
    config = colmap.BundleAdjustmentConfig()
    for key in scene.reg_image_ids():
        image = scene.images[key]
        if sum(keypoint.has_point3D() for keypoint in image.points2D) < FEWEST_OBSERVATIONS:
            continue
        config.add_image(key)
        if points_only:
            config.set_constant_rig_from_world_pose(image.frame_id)
    colmap.create_default_bundle_adjuster(options, config, scene).solve()


def thinned(colmap: Any, scene: Any) -> Any:
    """Copy the scene with fewer points: each photo keeps `ENOUGH`, or all if it has fewer."""
    scene = colmap.Reconstruction(scene)
    kept: Counter[int] = Counter()
    keys = np.array(sorted(scene.point3D_ids()), dtype=int)
    for key in np.random.default_rng(0).permutation(keys).tolist():
        photos = {element.image_id for element in scene.points3D[key].track.elements}
        if any(kept[photo] < ENOUGH for photo in photos):
            kept.update(photos)
        else:
            scene.delete_point3D(key)
    return scene


def with_cameras_of(colmap: Any, scene: Any, fitted: Any, scale: float) -> Any:
    """Copy the scene with the cameras and poses of `fitted`, and adjust its points to them.

    Args:
        fitted: a reconstruction of the same photos.
        scale: see `adjust`, whose loss is Cauchy's.
    """
    own = {key for key, image in fitted.images.items() if image.camera_id not in scene.cameras}
    moved = with_own_cameras(colmap, scene, own) if own else colmap.Reconstruction(scene)
    rigs = has_rigs(scene)
    for key, image in fitted.images.items():
        camera = moved.cameras[moved.images[key].camera_id]
        camera.model, camera.params = image.camera.model, image.camera.params
        if image.has_pose and not rigs:
            frame = moved.frames[moved.images[key].frame_id]
            frame.set_cam_from_world(moved.images[key].camera_id, image.cam_from_world())
    if rigs:  # the model still has them
        for key, rig in moved.rigs.items():
            for sensor in rig.non_ref_sensors:
                rig.set_sensor_from_rig(sensor, fitted.rigs[key].sensor_from_rig(sensor))
        for key, frame in moved.frames.items():
            if fitted.frames[key].has_pose:
                frame.rig_from_world = fitted.frames[key].rig_from_world
    adjust(colmap, moved, "CAUCHY", scale, points_only=True)
    return moved


def to_leave_out(scene: Any, anchors: Collection[tuple[int, int]] = ()) -> list[Observation]:
    """Choose one observation of every third point with a long track, to test an adjustment.

    `anchors`: ids of photos and keypoints that must stay.
    """
    found = []
    lengths = {key: len(scene.points3D[key].track.elements) for key in scene.point3D_ids()}
    points = [key for key in sorted(lengths) if lengths[key] >= LONG_TRACK]
    for number, point in enumerate(points[::LEFT_OUT_EVERY]):
        elements = scene.points3D[point].track.elements
        first = number % len(elements)
        for element in (*elements[first:], *elements[:first]):
            if (element.image_id, element.point2D_idx) not in anchors:
                found.append((element.image_id, element.point2D_idx, point))
                break
    return found


def median_error(scene: Any, observations: Sequence[Observation]) -> float:
    """Median reprojection error, px; an observation whose point is not in view counts as inf."""
    found = np.full(len(observations), np.inf)
    for row, (image, keypoint, point) in enumerate(observations):
        photo = scene.images[image]
        seen = photo.project_point(scene.points3D[point].xyz)
        if seen is not None:
            found[row] = np.linalg.norm(photo.points2D[keypoint].xy - seen)
    return float(np.median(found))


FULLER, FULLEST = "OPENCV", "FULL_OPENCV"
# Lens model -> model that it includes -> that model's index of each of its first parameters; the
# other parameters are 0.
INCLUDED = {
    FULLER: {
        "SIMPLE_PINHOLE": (0, 0, 1, 2),
        "PINHOLE": (0, 1, 2, 3),
        "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
        "RADIAL": (0, 0, 1, 2, 3, 4),
    },
    FULLEST: {FULLER: tuple(range(8))},
}
FEWEST_PHOTOS = 5  # a camera with fewer photos gets no more parameters
REACH, SAMPLES = 2.0, 2000  # a lens is checked up to this multiple of the corners; points checked


def with_fuller_cameras(colmap: Any, scene: Any, model: str = FULLER) -> int:
    """Convert cameras to a lens model that includes theirs; returns their number.

    A camera of few photos keeps its model: more parameters would overfit.
    """
    changed = 0
    photos = Counter(image.camera_id for image in scene.images.values())
    for key, camera in scene.cameras.items():
        places = INCLUDED[model].get(camera.model.name)
        if places is None or photos[key] < FEWEST_PHOTOS:
            continue
        values = [float(camera.params[place]) for place in places]
        camera.model = getattr(colmap.CameraModelId, model)
        camera.params = values + [0.0] * (PARAMETER_COUNT[model] - len(values))
        changed += 1
    return changed


def with_own_cameras(colmap: Any, scene: Any, photos: Collection[int]) -> Any:
    """Copy the scene and give each of some photos (by id) a camera of its own.

    Focusing changes the focal length, in some lenses by a per cent. Photos lose their names (text
    files cannot hold all names), and rigs are dissolved.
    """
    scene = colmap.Reconstruction(scene)
    for key, image in scene.images.items():
        image.name = str(key)
    with scratch("roigs-cameras-") as folder:
        scene.write_text(str(folder))
        cameras = {line.split()[0]: line.split()[1:] for line in _lines(folder / "cameras.txt")}
        free = max(map(int, cameras)) + 1
        images = _lines(folder / "images.txt")
        for row in range(0, len(images) - 1, 2):
            words = images[row].split()
            if int(words[0]) in photos:
                cameras[str(free)], words[8] = cameras[words[8]], str(free)
                images[row] = " ".join(words)
                free += 1
        lines = [" ".join([key, *values]) for key, values in cameras.items()]
        (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / "images.txt").write_text("\n".join(images) + "\n", encoding="utf-8")
        for rest in ("rigs.txt", "frames.txt"):  # created anew, with each photo by itself
            (folder / rest).unlink(missing_ok=True)
        return colmap.Reconstruction(str(folder))


def has_rigs(scene: Any) -> bool:
    """Whether cameras are fixed to each other."""
    return any(rig.num_sensors() > 1 for rig in scene.rigs.values())


def is_sound(camera: Any) -> bool:
    """Whether a FULL_OPENCV lens maps rays to its picture one to one, up to the corners.

    Its distortion is a fraction: where the denominator reaches zero, places jump.
    """
    if camera.model.name != FULLEST:
        return True
    fx, fy, cx, cy, k1, k2, _, _, k3, k4, k5, k6 = camera.params
    corner = np.hypot(
        max(cx, camera.width - cx) / min(fx, fy), max(cy, camera.height - cy) / min(fx, fy)
    )
    r = np.linspace(0, REACH * corner, SAMPLES)
    upper, lower = (np.polyval([c, b, a, 1.0], r**2) for a, b, c in ((k1, k2, k3), (k4, k5, k6)))
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = r * upper / lower
    beyond = np.flatnonzero(~(lower > 0) | (seen > corner))
    if not len(beyond) or not lower[beyond[0]] > 0:
        return False
    return bool((np.diff(seen[: beyond[0] + 1]) > 0).all())


def _lines(path: Path) -> list[str]:
    """The lines of a text file without comments; empty ones stay (a photo without points)."""
    lines = path.read_text(encoding="utf-8").split("\n")[:-1]
    return [line for line in lines if not line.startswith("#")]
