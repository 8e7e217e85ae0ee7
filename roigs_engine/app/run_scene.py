"""Finds the scene of a run folder."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, EngineError
from ..exchange.arrays import UP
from ..formats import run_files
from ..formats.files import read_record
from ..formats.gravity import gravity_alignment
from ..requests.choices import MAX_SIDE

if TYPE_CHECKING:
    from ..model.scene import Float64, SfmScene

FLAGS = ("no_masks", "invert_masks", "no_exposures")  # options that decide pixels


def poses_of_run(folder: Path) -> Float64 | None:
    """(N, 4, 4) world_to_camera of the photos of a run's scene; None if it cannot be read."""
    from ..colmap.project import load_poses

    for place in _places(folder):
        with suppress(EngineError):
            poses = load_poses(place)
            return poses if len(poses) else None
    return None


def levelled_run(result: Path) -> Path:
    """Return the run folder of a result with levels of detail; ConfigError without levels."""
    folder = result.absolute().parent
    if result.name != run_files.RESULT or not (folder / run_files.LEVELS_FILE).is_file():
        raise ConfigError(
            f"{result} has no levels of detail.",
            f"Make them with `levels`, and give the {run_files.RESULT} of that run.",
        )
    return folder


def cameras_of_run(folder: Path, scene: Path | None, context: Context) -> SfmScene:
    """Load the cameras that a run was trained with, at its photo size.

    Args:
        folder: of the run.
        scene: present place of its scene; None for the place at its training.
        context: receives warnings.

    Raises:
        ConfigError: the scene was moved or deleted.
        SceneError: it cannot be used.
    """
    for place in [scene] if scene else _places(folder):
        if scene or place.is_dir():
            found = _cameras(folder, place, None if scene else _path(folder, "images"), context)
            warn_of_other_cameras(folder, found, context)
            return used_photos(found, _photos(folder))
    raise ConfigError(
        f"The scene of {folder} was moved or deleted.", "Give its folder with --scene."
    )


def warn_of_other_model(folder: Path, scene: Path, images: Path | None, context: Context) -> None:
    """Warn as `warn_of_other_cameras` does, for a scene whose photos may have another size.

    Args:
        folder: of the run.
        scene: used with the run's result.
        images: folder of its photos; None to find it.
        context: receives the warning.
    """
    with suppress(EngineError):  # the caller reports an unusable scene
        warn_of_other_cameras(folder, _cameras(folder, scene, images, QUIET), context)


def _cameras(folder: Path, scene: Path, images: Path | None, context: Context) -> SfmScene:
    """Load a scene's cameras at a run's photo size; SceneError if it cannot be used."""
    from ..colmap.project import load_colmap

    size: dict[str, Any] = {"max_side": _longest_side(folder)}
    downscale = read_record(folder / run_files.SETTINGS).get("downscale")
    if isinstance(downscale, int | float) and 1 <= downscale <= MAX_SIDE:
        size = {"downscale": float(downscale)}
    return load_colmap(scene, images=images, pixels=False, context=context, **size)


def warn_of_other_cameras(folder: Path, scene: SfmScene, context: Context) -> None:
    """Warn if a scene has other cameras than a run was trained with: results would be wrong.

    Another reconstruction has another frame, even with the same photos and names.

    Args:
        folder: of the run.
        scene: in the world's frame, at the run's photo size.
        context: receives the warning.
    """
    model = read_record(folder / run_files.MANIFEST).get("model")
    photos = _photos(folder)
    if photos is None or not isinstance(model, str):
        return
    if used_photos(scene, photos).digest()[: len(model)] != model:
        context.warn(
            f"The scene has other cameras or points than {folder} was trained with: results are"
            " wrong if they have moved. Train again, or give --scene the model of that training."
        )


def used_photos(scene: SfmScene, photos: Collection[str] | None) -> SfmScene:
    """Return the scene with these photos alone; all of it if they are unknown, or none is there."""
    if photos is None:
        return scene
    others = {image.name for image in scene.images}.difference(photos)
    return scene.without(others) if len(others) < len(scene.images) else scene


def _photos(folder: Path) -> set[str] | None:
    """The names of a run's photos; None: unknown."""
    photos = read_record(folder / run_files.MANIFEST).get("contents")
    return set(photos) if isinstance(photos, dict) else None


@dataclass(frozen=True, kw_only=True)
class RunSource:
    """The photos that a run was trained on, as far as its folder tells.

    Attributes:
        scene, images: the project's folder, and the photos'; None: unknown.
        longest_side: of the photos, pixels; None: unknown.
        photos: their names; None: unknown.
        options: the run's masks and exposures, by option.
    """

    scene: Path | None = None
    images: Path | None = None
    longest_side: int | None = None
    photos: Collection[str] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


def source_of_run(model: Path) -> RunSource:
    """The photos of a result's run; ConfigError: the model is only a part of a result."""
    folder = _run_folder(model)
    if folder is None:
        return RunSource()
    if model.name != run_files.RESULT:
        raise ConfigError(
            f"{model} is only a part of a result, but the photos show all of it.",
            f"Give {folder / run_files.RESULT}.",
        )
    settings = read_record(folder / run_files.SETTINGS)
    flags = {name: True for name in FLAGS if settings.get(name) is True}
    masks = _path(folder, "masks")
    return RunSource(
        scene=next((place for place in _places(folder) if place.is_dir()), None),
        images=_path(folder, "images"),
        longest_side=_longest_side(folder),
        photos=_photos(folder),
        options=flags if masks is None else flags | {"masks": masks},
    )


def cameras_of_result(path: Path, scene: Path | None = None) -> SfmScene | None:
    """Load the cameras of a file's run; None if it is not a run's, or they are gone.

    SceneError: `scene`, the present place of the run's scene, cannot be used.
    """
    folder = _run_folder(path)
    if scene is not None:
        return cameras_of_run(folder or path.absolute().parent, scene, QUIET)
    if folder is None:
        return None
    with suppress(EngineError):
        return cameras_of_run(folder, None, QUIET)
    return None


def _run_folder(path: Path) -> Path | None:
    """Return the run folder of a result or of a part of one; None by the file's name or folder."""
    folder = folder_of_model(path)
    part = folder != path.absolute().parent
    return folder if part or path.name in (run_files.RESULT, run_files.BACKGROUND) else None


def folder_of_model(path: Path) -> Path:
    """Return the folder that would be the run's: that of the model, or above a folder of parts."""
    folder = path.absolute().parent
    return folder.parent if folder.name in (run_files.FINE, run_files.COARSE) else folder


def _longest_side(folder: Path) -> int | None:
    """Return the longest side of a run's training photos in pixels; None if unknown."""
    with suppress(TypeError, ValueError):
        sizes = read_record(folder / run_files.MANIFEST).get("sizes", ())
        side = max(int(side) for size in sizes for side in str(size).split("x"))
        return side if 0 < side <= MAX_SIDE else None
    return None


def _path(folder: Path, option: str) -> Path | None:
    """Return a path from the settings of a run; None if missing or damaged."""
    found = read_record(folder / run_files.SETTINGS).get(option)
    return Path(found) if isinstance(found, str) and found else None


def up_in_run(path: Path) -> str | None:
    """Return the approximate up axis of a run's PLY, from the photos of its scene.

    None if the PLY is not a run's, or the scene is not there.
    """
    folder = _run_folder(path)
    poses = poses_of_run(folder) if folder else None
    if poses is None:
        return None
    up = gravity_alignment(poses)[2]
    return max(UP, key=lambda axis: float(np.array(UP[axis])[:, 2] @ up))


def _places(folder: Path) -> list[Path]:
    """Return possible places of a run folder's scene, the likelier one first."""
    known = _path(folder, "scene")
    return [*([] if known is None else [known]), folder / run_files.PROJECT]
