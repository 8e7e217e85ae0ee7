"""Loads a COLMAP project as an `SfmScene`: model, photos, undistortion, masks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import ConfigError, SceneError
from ..formats import projects
from ..formats.rois import FAR
from ..formats.text import counted, named
from ..model.scene import Float64, Int64, SfmScene
from ..model.scene_checks import without_outliers
from ..photos.files import PhotoFolder, find_photos
from ..photos.mask_paths import USUAL_MASKS, MaskOptions
from ..requests.choices import MAX_DOWNSCALE, MAX_SIDE
from .camera_masks import HIDDEN
from .lenses import HINT_RESAMPLE
from .model_files import HINT_DAMAGED, count_images, read_images, read_model
from .photo_loader import (
    CANNOT_UNDISTORT,
    MISSING,
    UNPOSED,
    PhotoLoader,
    Shrink,
    Skip,
    photo_name,
    pose_of,
    stored_photo,
)
from .records import NO_IDS, Model
from .rotations import Cloud, StoredPhoto, find_turns

MODEL_FILES = ("cameras", "images", "points3D")
LEAST_EXTENT = 1e-20  # world units; the squares of much smaller numbers underflow
SIMPLE_LENSES = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # with fewer parameters than OPENCV


def load_colmap(
    path: Path | str,
    *,
    images: Path | str | None = None,
    cache: Path | None = None,
    downscale: float | None = None,
    max_side: int | None = None,
    masks: MaskOptions = USUAL_MASKS,
    pixels: bool = True,
    check: Callable[[SfmScene], None] | None = None,
    context: Context = QUIET,
) -> SfmScene:
    """Load the scene of a COLMAP project.

    Args:
        path: project folder with `sparse/0` or `sparse`, or the model's own folder.
        images: the photos' folder; default: the first of the folders `images`, `images_2`,
            `images_4` and `images_8` of the project that has any of the model's photos.
        cache: folder for undistorted photos and facts about photos; default: a temporary one.
        downscale: divides the photos' size, >= 1.
        max_side: longest side in pixels; photos are never enlarged.
        masks: which masks of photos to use; default: those in the folder `masks` beside the
            photos' folder, files `NAME.mask.png` beside photos, and alpha channels; no masks of
            boxes' objects.
        pixels: False if only cameras are needed. The cameras are the same, but nothing is decoded
            or undistorted, damaged photos are not all found, and `path` names the distorted photo.
            Photos have digests and masks of their own only with a `cache`, which is not written.
            Without pycolmap, distortion is then ignored.
        check: called with the cameras before any photo is decoded; raises an error to stop.

    Raises:
        SceneError: there is no usable model, point or photo, or a mask cannot be used.
        ConfigError: `downscale` or `max_side` is out of range, or a folder of masks is missing.
        RunFolderError: `cache` cannot be written.
    """
    masks.check()
    shrink = smaller(downscale, max_side)
    folder = find_model(Path(path), context)
    model = read_model(folder, context)
    ids, points, colors = _points(model, folder, context)
    photos = find_photos(folder, images, [image.name for image in model.images])
    observed = _observations(model, ids, context)
    cloud = Cloud(points=points, colors=colors, observed=observed)
    loader = PhotoLoader(model, photos, shrink, cloud, pixels=pixels, masks=masks, context=context)
    if any(map(len, observed.values())):
        _mention_refined(model, folder, context)
    if check is not None and loader.posed:
        check(without_outliers(_scene(loader, observed, points, colors)))
    loader.load(cache, context)
    if not loader.posed:
        raise _no_photos(model, folder, photos, loader)
    if photos.folder.name in projects.PHOTO_FOLDERS[1:]:
        context.info(f"The photos are the smaller ones of {photos.folder.name}.")
    loader.skipped[UNPOSED] += photos.others([image.name for image in model.images])
    return _cleaned(_scene(loader, observed, points, colors), loader.why, context)


def _scene(
    loader: PhotoLoader, observed: dict[int, Int64], points: Float64, colors: NDArray[np.uint8]
) -> SfmScene:
    found = [
        replace(image, point_indices=observed.get(image_id, NO_IDS))
        for image_id, image in loader.posed.items()
    ]
    return SfmScene(
        images=tuple(sorted(found, key=lambda image: image.name)),
        points=points,
        colors=colors,
        has_tracks=any(len(image.point_indices) for image in found),
        skipped={why: tuple(sorted(names)) for why, names in loader.skipped.items() if names},
    )


def _mention_refined(model: Model, folder: Path, context: Context) -> None:
    """If the lens model is simple, mention the refined cameras, or how to make them."""
    used = {camera.model for camera in model.cameras.values()}
    simple = [name for name in SIMPLE_LENSES if name in used]
    if not simple or projects.is_refined_name(folder):
        return
    refined = projects.refined_folder(folder)
    if projects.is_refined_model(refined):
        context.info(f"{refined} has refined cameras: with that folder, results are sharper.")
    else:
        context.info(
            f"The model's lens ({', '.join(simple)}) has few parameters. If the photos' lens needs"
            " more, refined cameras make results sharper (`refine-cameras`)."
        )


def _cleaned(scene: SfmScene, why: Mapping[str, Skip], context: Context) -> SfmScene:
    """Remove outliers; report what was left out, as warnings except for unposed photos."""
    scene = without_outliers(scene)
    if 0 < (extent := scene.extent()) < LEAST_EXTENT:
        raise SceneError(f"The cameras span {extent:.0e} units.", "Scale the model up.")
    if scene.stray_points:
        context.warn(f"Left out {counted(scene.stray_points, '3D point')} far from all cameras.")
    for reason, names in scene.skipped.items():
        emit = context.info if reason == UNPOSED else context.warn
        more = f" {why[reason].text}." if reason in why and why[reason].text else ""
        emit(f"Skipped {counted(len(names), 'photo')}, {reason}: {named(names)}.{more}")
    return scene


def model_turns(
    model: Model, folder: Path, photos: PhotoFolder, context: Context = QUIET
) -> dict[int, int]:
    """Find a model's turned photos (`rotations`): image id -> turn; SceneError: no points."""
    quiet = replace(context, emit=QUIET.emit)  # the code that uses the model reports damage
    ids, points, colors = _points(model, folder, quiet)
    cloud = Cloud(points=points, colors=colors, observed=_observations(model, ids, context))
    found = []
    for image in model.images:
        context.check_cancelled()
        found.append(stored_photo(image, model, photos))
    return find_turns([p for p in found if isinstance(p, StoredPhoto)], cloud, context)


def find_model(path: Path, context: Context = QUIET) -> Path:
    """Find the model of a project: `path`, `path/sparse` or one of their numbered subfolders.

    A project's folder of photos stands for the project. If there are several models, the one with
    the most photos is used, with a warning. SceneError: there is none.
    """
    if projects.model_suffix(path):
        return path
    if not path.is_dir():
        raise SceneError(f"{path} is not a folder.", "Give the project's folder.")
    path = projects.project_folder(path)
    counts = {folder: count_images(folder) for folder in projects.model_folders(path)}
    if not counts:
        raise _no_model(path)
    best = max(counts, key=lambda folder: counts[folder])
    if len(counts) > 1:
        others = (f"{f.relative_to(path)}: {n}" for f, n in counts.items() if f != best)
        context.warn(
            f"{path} has {len(counts)} models; using {best.relative_to(path)} with"
            f" {counted(counts[best], 'photo')} (others: {', '.join(others)})."
        )
    return best


OTHER_MODELS = {
    "transforms*.json": (
        "nerfstudio's",
        "Give the COLMAP model it was made from (colmap/sparse/0).",
    ),
    "sfm_data*": ("OpenMVG's", "Export it for COLMAP."),
    "reconstruction.json": ("OpenSfM's", "Export it for COLMAP."),
    "*.nvm": ("VisualSFM's", "Reconstruct the photos, or export them for COLMAP."),
    "*.out": ("Bundler's", "Export the cameras for COLMAP."),
    "*.csv": ("perhaps RealityCapture's registration", "Export it for COLMAP."),
    "*.rcproj": ("RealityCapture's project", "Export its registration for COLMAP."),
    "*.psx": ("Metashape's project", "Export its cameras for COLMAP."),
    "*.xml": ("perhaps Metashape's cameras", "Export them for COLMAP."),
    "database.db": ("COLMAP's matches", "Run its mapper, which writes sparse/0."),
}
"""Files of other software and of unfinished work -> hint for the user."""


def _no_model(path: Path) -> SceneError:
    """The error for a folder without a model; names what is there instead."""
    missing = f"{path} has no COLMAP model"
    for folder in (path, path / projects.SPARSE, path / projects.SPARSE / projects.FIRST_MODEL):
        lacks = [
            stem
            for stem in MODEL_FILES
            if not any((folder / (stem + suffix)).is_file() for suffix in projects.SUFFIXES)
        ]
        if 0 < len(lacks) < len(MODEL_FILES):
            hint = "Export the model again: it needs cameras, images and points3D, of one kind."
            return SceneError(f"{missing}: {folder} lacks {' and '.join(lacks)}.", hint)
    for pattern, (what, hint) in OTHER_MODELS.items():
        found = next(iter(sorted(path.glob(pattern))), None)
        if found is not None:
            return SceneError(f"{missing}: {found.name} is {what}.", hint)
    return SceneError(
        f"{missing}.",
        "Give a folder with sparse/0, or one with cameras, images and points3D files.",
    )


def load_poses(path: Path) -> Float64:
    """Read world_to_camera (N, 4, 4) of all photos of a project; raises as `read_images`."""
    poses = [pose_of(image) for image in read_images(find_model(path))]
    return np.array([pose for pose in poses if pose is not None]).reshape(-1, 4, 4)


def smaller(downscale: float | None, max_side: int | None) -> Shrink:
    """The function from a photo's (width, height) to the requested size; see `load_colmap`."""
    if downscale is not None and not 1 <= downscale <= MAX_DOWNSCALE:
        raise ConfigError(
            f"downscale is {downscale:g}.", f"Use a number from 1 to {MAX_DOWNSCALE:,}."
        )
    if max_side is not None and not 1 <= max_side <= MAX_SIDE:
        raise ConfigError(f"max_side is {max_side}.", f"Use 1 to {MAX_SIDE:,} pixels.")

    def shrink(width: int, height: int) -> tuple[int, int]:
        scale = 1 / (downscale or 1)
        if max_side is not None:
            scale = min(scale, max_side / max(width, height))
        return max(1, round(width * scale)), max(1, round(height * scale))

    return shrink


def _points(
    model: Model, folder: Path, context: Context
) -> tuple[Int64, Float64, NDArray[np.uint8]]:
    """Ids (ascending), positions and colours of the points with valid numbers."""
    finite = (np.abs(model.points) < FAR).all(axis=1)  # False for NaN
    numbered = model.point_ids >= 0
    good = finite & numbered
    counts = ((~finite, "without a valid position"), (~numbered, "with a negative id"))
    reasons = ", ".join(f"{wrong.sum():,} {why}" for wrong, why in counts if wrong.any())
    if not len(good):
        raise SceneError(
            f"The model in {folder} has no 3D points.",
            "Export the sparse point cloud with the model: training starts from it.",
        )
    if not good.any():
        raise SceneError(
            f"All {counted(len(good), '3D point')} in {folder} are unusable ({reasons}).",
            HINT_DAMAGED,
        )
    if not good.all():
        context.warn(f"Skipped {counted(int((~good).sum()), '3D point')}: {reasons}.")
    rows = slice(None) if good.all() else np.flatnonzero(good)
    ids = model.point_ids[rows]
    if not (ids[1:] > ids[:-1]).all():  # usually they ascend
        ids, first = np.unique(ids, return_index=True)
        rows = np.flatnonzero(good)[first]
    return ids, model.points[rows], model.colors[rows]


def _observations(model: Model, ids: Int64, context: Context) -> dict[int, Int64]:
    """Image id -> ascending rows of the points that it observes; unknown ids are ignored.

    Uses the photos' lists of observations, or the points' tracks if the photos have no lists.
    """
    seen = {image.image_id: image.point_ids for image in model.images}
    if len(model.track_rows):
        order = np.argsort(model.track_images, kind="stable")
        viewers, starts = np.unique(model.track_images[order], return_index=True)
        by_viewer = np.split(model.point_ids[model.track_rows[order]], starts[1:])
        seen = dict(zip((int(viewer) for viewer in viewers), by_viewer, strict=True))
    observed = {}
    for image_id, values in seen.items():
        context.check_cancelled()
        unique = np.unique(values)
        rows = np.minimum(np.searchsorted(ids, unique), len(ids) - 1)
        observed[image_id] = rows[ids[rows] == unique].astype(np.int64)
    return observed


def _no_photos(model: Model, folder: Path, photos: PhotoFolder, loader: PhotoLoader) -> SceneError:
    skipped = loader.skipped
    if not model.images:
        return SceneError("The model has no posed photos.", "Run COLMAP's mapper to its end.")
    counts = ", ".join(f"{len(names)} {reason}" for reason, names in skipped.items())
    reason = max(skipped, key=lambda reason: len(skipped[reason]))
    if reason.endswith(CANNOT_UNDISTORT):
        return SceneError(f"The model's photos cannot be used ({counts}).", HINT_RESAMPLE)
    if reason == HIDDEN:
        hint = "Use --invert-masks if black marks the used pixels, or --no-masks."
        return SceneError(f"The model's photos cannot be used ({counts}).", hint)
    why = loader.why.get(reason, Skip(reason))
    text = f"The model's photos cannot be used ({counts})"
    text += f": {why.text}." if why.text else "."
    other = _folder_with(model, folder) if reason == MISSING else None
    hint = f"{other} has such photos: give it with --images." if other else why.hint
    return SceneError(text, hint or "Export the model again, with its photos.")


def _folder_with(model: Model, folder: Path) -> Path | None:
    """A folder of the project that has the model's first photo; None: not found."""
    first = photo_name(model.images[0])
    for root in projects.folders_above(folder):
        with suppress(OSError):
            for child in sorted(root.iterdir()):
                if (child / first).is_file():
                    return child
    return None
