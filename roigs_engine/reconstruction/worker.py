"""A child process for long calls of pycolmap; it can be killed at any time.

`python -m roigs_engine.reconstruction.worker` reads a task, one line of JSON, from standard input,
and ends when standard input is closed. Each line on standard output is JSON: `{"registered": 12}`,
`{"result": ...}` or `{"error": "..."}`. pycolmap's own messages go to standard error.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..colmap.library import pycolmap_module
from ..colmap.model_files import pycolmap_model
from ..errors import EngineError, SceneError
from ..formats.gravity import Matrix, Vector, gravity_alignment
from ..model.scene import origin
from .database import (
    FEWEST_INLIERS,
    Pair,
    camera_ids,
    match_counts,
    numbers,
    show_spaces,
    spaces_hidden,
)

Task = dict[str, Any]
NEEDED = ("FeatureExtractionOptions", "FeatureMatchingOptions", "match_image_pairs")
DISTANCE = 2.0  # from cameras to their points, scene units; so a unit is roughly a metre
SHARES = (0.25, 0.4, 0.6, 0.8)  # least shares of inliers for RANSAC; the first is COLMAP's
LAID = 0.02  # of the photos' extent: tolerance for a photo's place in two models
LAYERS = 200  # layers of height, in the search for the floor
FLOOR = 3.0  # x the points of the median filled layer; a layer with more may be the floor
LOWEST = 0.02  # share of the points below the floor, if no layer stands out


def colmap_module() -> Any:
    """The module pycolmap; EngineError if it is missing or too old."""
    colmap = pycolmap_module("Reconstructing photos")
    if not all(hasattr(colmap, name) for name in NEEDED):
        raise EngineError(
            f"Reconstructing photos needs pycolmap 4.2; this is {colmap.__version__}.",
            "Run: pip install --upgrade pycolmap",
        )
    return colmap


def extract(colmap: Any, task: Task) -> None:
    """Find the features of the photos; photos already in the database are skipped."""
    options = colmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = task["threads"]
    options.max_image_size = task["max_side"]
    options.sift.max_num_features = task["features"]
    reader = colmap.ImageReaderOptions()
    reader.camera_model = task["camera_model"]
    for group in task["groups"]:
        reader.existing_camera_id = group["camera"]
        given, masks = group["names"], task["masks"]
        masked = [name for name in given if masks and Path(masks, f"{name}.png").is_file()]
        # pycolmap would skip photos without a mask, so these are processed separately.
        rest = [name for name in given if name not in set(masked)]
        for folder, names in ((masks, masked), ("", rest)):
            if not names:
                continue
            reader.mask_path = folder
            colmap.extract_features(
                task["database"],
                task["photos"],
                image_names=names,
                camera_mode=colmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=options,
                device=colmap.Device.cpu,
            )
            cameras = camera_ids(Path(task["database"]))
            known = [cameras[name] for name in names if name in cameras]
            reader.existing_camera_id = known[0] if known else reader.existing_camera_id


def match(colmap: Any, task: Task) -> None:
    """Match the pairs in a file; pairs already in the database are skipped.

    All pairs are matched first. Then they are verified in groups by their number of matches: a pair
    needs `FEWEST_INLIERS`, so RANSAC need not search for a smaller share of inliers.
    """
    database, listed = Path(task["database"]), Path(task["pairs"])
    options = colmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = task["threads"]
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = task["seed"]
    pairing = colmap.ImportedPairingOptions()

    def work(lines: Path) -> None:
        pairing.match_list_path = str(lines)
        colmap.match_image_pairs(
            str(database),
            matching_options=options,
            pairing_options=pairing,
            verification_options=verification,
            device=colmap.Device.cpu,
        )

    with spaces_hidden(database):
        options.skip_geometric_verification = True
        work(listed)
        options.skip_geometric_verification = False
        # `splitlines` and `split()` would also split at the substitutes for spaces in names.
        lines = listed.read_text("utf-8").rstrip("\n").split("\n")
        alike = listed.with_name("alike.txt")
        for share, same in by_share(lines, match_counts(database)).items():
            verification.ransac.min_inlier_ratio = share
            alike.write_text("\n".join(same), "utf-8", newline="\n")
            work(alike)


def by_share(lines: Sequence[str], counts: Mapping[Pair, int]) -> dict[float, list[str]]:
    """Group pairs by the share of inliers that they need at least, one of `SHARES`.

    `lines` are as in `pair_line`; `counts`: the number of matches of each pair.
    """
    alike: dict[float, list[str]] = {}
    for line in lines:
        one, other = sorted(line.split(" "))
        needed = FEWEST_INLIERS / max(counts.get((one, other), 0), FEWEST_INLIERS)
        share = max((share for share in SHARES if share <= needed), default=SHARES[0])
        alike.setdefault(share, []).append(line)
    return alike


def map_photos(colmap: Any, task: Task) -> list[dict[str, Any]]:
    """Find cameras and points; returns the models as records, the largest first."""
    options = colmap.IncrementalPipelineOptions()
    options.random_seed = task["seed"]
    options.num_threads = task["threads"]
    for place, values in task["options"].items():
        part = getattr(options, place) if place else options
        for key, value in values.items():
            setattr(part, key, value)
    out = Path(task["out"])
    out.mkdir(parents=True, exist_ok=True)
    start = task.get("start", "")
    before = _model(colmap, task["earlier"]) if task.get("earlier") else None
    grows = bool(before and task.get("grows"))
    if before and grows:
        if _is_of(before, Path(task["database"])):
            options.fix_existing_frames = True
            options.constant_cameras = set(before.cameras)
        else:  # the database or the model has changed
            grows, start = False, ""
    try:
        registered = _model(colmap, start).num_reg_images() if start else 0
    except SceneError:  # the snapshot is damaged, for example by a power cut
        start, registered = "", 0

    def step() -> None:
        nonlocal registered
        registered += 1
        say({"registered": registered})

    found = colmap.incremental_mapping(
        task["database"],
        task["photos"],
        out,
        options,
        input_path=start,
        initial_image_pair_callback=step,
        next_image_callback=step,
    )
    for model in found.values():
        if not (grows or (before and _laid_onto(model, before))):
            _normalise(model)
    records = [_written(model, out / f"model-{key}") for key, model in found.items()]
    return sorted(records, key=lambda record: -len(record["photos"]))


def _model(colmap: Any, folder: str) -> Any:
    """Read a model; SceneError if it is damaged (pycolmap might not return from it)."""
    return pycolmap_model(colmap, Path(folder))[1]


def _is_of(model: Any, database: Path) -> bool:
    """Whether a model's photos have the same ids and numbers of features as a database."""
    own = {image.name: (key, len(image.points2D)) for key, image in model.images.items()}
    return own.items() <= numbers(database).items()


def _laid_onto(model: Any, earlier: Any) -> bool:
    """Align a model with an earlier one of the same photos; False if this fails."""
    here, there = _marks(model), _marks(earlier)
    both = sorted(here.keys() & there.keys())
    if len(both) < 2:
        return False
    options = colmap_module().RANSACOptions()
    target = np.concatenate([there[name] for name in both])
    options.max_error = LAID * float(np.linalg.norm(np.ptp(target, axis=0)))
    options.random_seed = 0
    source = np.concatenate([here[name] for name in both])
    found = colmap_module().estimate_sim3d_robust(source, target, options)
    if found is None or 2 * found["num_inliers"] < len(target):
        return False
    model.transform(found["tgt_from_src"])
    return True


def _marks(model: Any) -> dict[str, Matrix]:
    """Photo -> (3, 3) points: its centre, and points at its viewing distance ahead and above."""
    marks = {}
    for image, seen in _looks(model):
        pose = image.cam_from_world().matrix()
        eye, ways = image.projection_center(), pose[(2, 1), :3] * ((1.0,), (-1.0,))
        marks[image.name] = np.vstack([eye, eye + seen * ways])
    return marks


def _looks(model: Any) -> list[tuple[Any, float]]:
    """The photos that observe points, each with their median distance from it."""
    points = {key: point.xyz for key, point in model.points3D.items()}
    looks = []
    for image in (model.images[key] for key in model.reg_image_ids()):
        seen = [points[spot.point3D_id] for spot in image.points2D if spot.has_point3D()]
        if seen:
            away = np.linalg.norm(np.array(seen) - image.projection_center(), axis=1)
            looks.append((image, float(np.median(away))))
    return looks


def _written(model: Any, folder: Path) -> dict[str, Any]:
    """Write a model; returns its figures as plain values."""
    folder.mkdir()
    model.write_binary(str(folder))
    images = [model.images[key] for key in sorted(model.reg_image_ids())]
    return {
        "folder": str(folder),
        "photos": {image.name: image.num_points3D for image in images},
        "points": model.num_points3D(),
        "error": model.compute_mean_reprojection_error(),
        "track": model.compute_mean_track_length(),
    }


def _normalise(model: Any) -> None:
    images = [model.images[key] for key in model.reg_image_ids()]
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    for pose, image in zip(poses, images, strict=True):
        pose[:3] = image.cam_from_world().matrix()
    distances = [distance for _, distance in _looks(model)]
    if distances:
        points = np.array([point.xyz for point in model.points3D.values()])
        matrix = normalisation(poses, points, float(np.median(distances)))
        model.transform(colmap_module().Sim3d(matrix))


def normalisation(poses: Matrix, points: Matrix, distance: float) -> Matrix:
    """The similarity (3, 4) to a standard frame: z up, floor at 0, points' middle at x = y = 0.

    Photos alone do not determine direction, position or scale. The scale is an estimate of metres.

    Args:
        poses: (N, 4, 4) world_to_camera of the photos.
        points: (M, 3), at least one.
        distance: median distance of the points from the cameras that observe them.
    """
    scale = DISTANCE / distance if distance > 0 else 1.0
    rotation = gravity_alignment(poses)
    aligned = scale * points @ rotation.T
    eyes = np.array([origin(pose) for pose in poses])
    heights = scale * eyes @ rotation[2]
    centre = np.append(np.median(aligned[:, :2], axis=0), floor(aligned[:, 2], float(max(heights))))
    return np.column_stack([scale * rotation, -centre])


def floor(heights: Vector, top: float) -> float:
    """The height of the floor: the lowest layer with many points below the highest camera."""
    low, high = np.quantile(heights, (LOWEST / 2, 1 - LOWEST / 2))
    counts, edges = np.histogram(heights, bins=LAYERS, range=(low, min(high, max(top, low))))
    filled = counts[counts > 0]
    if len(filled):
        many = counts >= max(FLOOR * np.median(filled), 0.5 * counts.max())
        if many.any():
            layer = int(np.argmax(many))
            inside = (heights >= edges[layer]) & (heights <= edges[layer + 1])
            if inside.any():
                return float(np.median(heights[inside]))
    return float(np.quantile(heights, LOWEST))


REPLIES = 1  # descriptor of the output that the parent reads; `main` moves it
WORK = {"extract": extract, "match": match, "map": map_photos}


def say(record: dict[str, Any]) -> None:
    """Send a line to the parent."""
    os.write(REPLIES, json.dumps(record).encode() + b"\n")


def _end_with_parent() -> None:
    """End this process when its parent is gone, at any point."""
    while os.read(0, 4096):
        pass
    os._exit(1)


def main() -> None:
    """Do the task on standard input."""
    global REPLIES
    REPLIES = os.dup(1)
    os.dup2(2, 1)  # pycolmap's output goes to the log
    with open(0, "rb", buffering=0, closefd=False) as given:
        task = json.loads(given.readline())  # `_end_with_parent` reads the rest
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        show_spaces(Path(task["database"]))
        say({"result": WORK[task["work"]](colmap_module(), task)})
    except EngineError as error:
        say({"error": error.message, "hint": error.hint})
    except Exception as error:  # pycolmap raises nearly anything
        last = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        say({"error": f"pycolmap failed ({last:.200})."})
    os._exit(0)


if __name__ == "__main__":
    main()
