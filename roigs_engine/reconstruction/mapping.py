"""Incremental mapping from matches to models, with lower limits for the remaining photos."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..context import Context
from .child import run_stage
from .folder import Folder

MAPPING = "mapping"
FEWEST = 3  # photos of a model
JOINED = 0.5  # a photo with less than this share of its own model's points is placed unreliably
Options = dict[str, dict[str, Any]]
"""Part of pycolmap's options -> name -> value; "": the options of the pipeline itself."""
# All cameras are adjusted once when the model has grown by 30 %, with non-redundant points only.
# COLMAP's defaults (10 %, five times, all points) take twice as long for equally exact cameras.
# All threads work on small adjustments, too (notebook/reconstruction.md).
FAST: Options = {
    "": {
        "ba_global_frames_ratio": 1.3,
        "ba_global_points_ratio": 1.3,
        "ba_global_max_refinements": 1,
        "ba_local_function_tolerance": 1e-3,
        "ba_min_num_residuals_for_cpu_multi_threading": 1000,
    },
    "mapper": {"ba_global_ignore_redundant_points3D": True},
}
# COLMAP's own limits are tried first. Lower ones start models that would not start otherwise, or
# add photos to a model.
STRICT: Options = {"": {"min_model_size": FEWEST, "max_num_models": 10}, "mapper": {}}
LOW_TO_ADD = {"abs_pose_min_num_inliers": 12, "abs_pose_min_inlier_ratio": 0.15}
LOW_TO_BEGIN = {"init_min_num_inliers": 30, "init_min_tri_angle": 2.0}
LOW: Options = {"": {"min_num_matches": 10, "multiple_models": False}, "mapper": LOW_TO_ADD}


@dataclass(frozen=True, kw_only=True)
class Mapped:
    """A model found by the mapper."""

    folder: str
    photos: dict[str, int]  # name -> number of points that the photo observes
    points: int
    error: float  # mean reprojection error, px
    track: float  # mean number of photos that observe a point


def map_models(
    folder: Folder, total: int, settings: dict[str, Any], context: Context
) -> list[Mapped]:
    """Find the models, the largest first; empty: no two photos could be registered.

    Args:
        settings: `seed` and `threads` of the task; `earlier`: the folder of an earlier model of
            this place, to align these with, or empty.

    After a stop, the next call resumes from snapshots. SceneError: pycolmap failed.
    """
    out = folder.emptied("models")
    snapshots = folder.work("snapshots")
    snapshots.mkdir(parents=True, exist_ok=True)
    own = {"snapshot_path": str(snapshots), "snapshot_frames_freq": max(20, total // 10)}
    options = STRICT | {"": STRICT[""] | own}
    # The second-to-last snapshot is always complete.
    older = sorted(path for path in snapshots.iterdir() if path.is_dir())[-2:-1]
    start = str(older[0]) if older else ""
    found = _map(folder, out / "first", options, settings, total, context, start)
    if not found:
        options |= {"mapper": LOW_TO_BEGIN | LOW_TO_ADD}
        found = _map(folder, out / "second", options, settings, total, context)
    shutil.rmtree(snapshots, ignore_errors=True)
    return found


def add_photos(
    folder: Folder, total: int, settings: dict[str, Any], context: Context
) -> list[Mapped]:
    """Add photos to the earlier model; its own cameras do not change. See `map_models`."""
    out = folder.emptied("models", "more")
    options = STRICT | {"": STRICT[""] | {"multiple_models": False}}
    return _map(folder, out, options, settings, total, context, settings["earlier"])


def map_rest(
    folder: Folder,
    models: Sequence[Mapped],
    names: Sequence[str],
    settings: dict[str, Any],
    context: Context,
) -> list[Mapped]:
    """Try to add more photos to the largest model with lower limits; see `map_models`.

    Photos of other models are added only if they fit as well as there.
    """
    best, total = models[0], len(names)

    def low(place: str, options: Options) -> list[Mapped]:
        out = folder.emptied("models", place)
        return _map(folder, out, options, settings, total, context, best.folder)

    found = low("rest", LOW)
    others = {
        name: points
        for model in models[1:]
        for name, points in model.photos.items()
        if name not in best.photos
    }
    # A photo from another model was added, but observes far fewer points than in that model.
    if found and any(found[0].photos.get(k, n) < JOINED * n for k, n in others.items()):
        kept = [name for name in names if name not in others]
        found = low("apart", LOW | {"": LOW[""] | {"image_names": kept}})
    if not found or len(found[0].photos) <= len(best.photos):
        return list(models)
    rest = [model for model in models[1:] if not model.photos.keys() <= found[0].photos.keys()]
    return [found[0], *rest]


def _map(
    folder: Folder,
    out: Path,
    options: Options,
    settings: dict[str, Any],
    total: int,
    context: Context,
    start: str = "",
) -> list[Mapped]:
    task = {
        "work": "map",
        "database": str(folder.database),
        "photos": str(folder.images),
        "out": str(out),
        "start": start,
        "options": {place: FAST[place] | values for place, values in options.items()},
        **settings,
    }
    found = run_stage(
        task, folder.log, MAPPING, total, lambda record: record.get("registered", 0), context
    )
    return [Mapped(**record) for record in found]
