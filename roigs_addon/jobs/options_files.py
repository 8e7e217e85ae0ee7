"""Writes options files for the engine, from the scene's properties and the user's settings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import bpy

from .. import settings
from ..engine import own_files
from ..engine.run_settings import RunSettings
from ..engine.writing import made_folder, writing
from ..errors import AddonError
from ..properties import object_props, scene_props
from ..scene import exclusions, lookup, masks, rois
from ..shared import files, others, run_files
from . import run_folders

OF_A_LIST = ("roi", "names")
"""Keys of a file with a list of photos."""


def _refuse_others(path: Path, *keys: str) -> None:
    """Raise AddonError for a file without these keys: the add-on did not write it."""
    if others.is_other(path, keys):
        raise AddonError(
            f"{path} was not written by this add-on. Move it, or choose another Run Folder."
        )


def common_options(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> dict[str, Any]:
    """Return the options of selection and training for an options file (docs/files.md).

    Raises:
        AddonError: there is no model, or there are no boxes.
    """
    colmap = colmap_folder(scene)
    if not boxes:
        raise AddonError("There are no boxes. Add one around each object to sharpen.")
    values = _selection_settings(scene) | {
        "scene": str(colmap),
        "threads": settings.get().threads or None,
        "exclude": excluded(scene) or None,
    }
    return {key: value for key, value in values.items() if value is not None}


def _selection_settings(scene: bpy.types.Scene) -> dict[str, Any]:
    props = scene_props(scene)
    return {
        "scene": props.colmap,
        "images": bpy.path.abspath(props.images) or None,
        "max_side": props.max_side,
        "method": props.method,
        "count": props.count or None,
        "seed": props.seed,
        "test_every": props.test_every,
    }


def _training_settings(scene: bpy.types.Scene) -> dict[str, Any]:
    props = scene_props(scene)
    return {
        "preset": props.preset,
        "steps_factor": float(f"{props.steps_factor:.5g}"),  # rounds Blender's 32-bit number
        "strategy": props.strategy,
        "made_for": props.made_for,
    }


def settings_now(scene: bpy.types.Scene, exclude: list[str]) -> RunSettings:
    """Return the settings of a training started now; `exclude` has the excluded photos."""
    values = _selection_settings(scene) | _training_settings(scene)
    return RunSettings.from_options(values | {"exclude": exclude}).of_this_version()


def excluded(scene: bpy.types.Scene) -> list[str]:
    """Names of the photos that the user has excluded, also by deleting their cameras.

    Raises:
        AddonError: no photo is left.
    """
    names = exclusions.excluded(scene)
    if names and not set(lookup.cameras(scene)).difference(names):
        raise AddonError("All photos are excluded. Click Include All in step 1.")
    return names


def colmap_folder(scene: bpy.types.Scene) -> Path:
    """Return the imported COLMAP folder.

    Raises:
        AddonError: there is none, or it no longer exists.
    """
    folder = scene_props(scene).colmap
    if not folder:
        raise AddonError("There are no cameras. Reconstruct photos or import cameras first.")
    if not os.path.isdir(folder):
        raise AddonError(
            f"The COLMAP folder {folder} no longer exists. Import it again from its new place."
        )
    return Path(folder)


def machine_options() -> list[str]:
    """Return the user's device and threads, for a command without an options file."""
    chosen = settings.get()
    return ["--device", chosen.device, *threads_option()]


def threads_option() -> list[str]:
    """Return the user's number of threads as an option; empty if all are used."""
    threads = settings.get().threads
    return ["--threads", str(threads)] if threads else []


MOVED = {"Give its folder with --scene.": "Import its COLMAP project again in step 1."}
"""Words of the engine's error about a moved scene -> words of the panel."""


def moved_scene(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Return the option with the present COLMAP project if it was moved after the training."""
    trained, now = files.read_record(folder / run_files.SETTINGS).get("scene"), scene_props(scene)
    moved = isinstance(trained, str) and not Path(trained).exists()
    return [f"--scene={now.colmap}"] if moved and now.colmap else []


def write_select_options(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> Path:
    """Write the options file of `select`; return its path."""
    values = common_options(scene, boxes)
    if folder := masks.in_run(run_folders.run_folder(scene)):  # training finds them itself
        values["object_masks"] = str(folder)
    if not values["test_every"]:
        del values["test_every"]
    return _write(scene, own_files.SELECT_OPTIONS, boxes, values)


def write_suggest_options(
    scene: bpy.types.Scene, boxes: list[bpy.types.Object], *, model: Path | None
) -> Path:
    """Write the options file of `suggest`; return its path.

    Args:
        scene: with the settings.
        boxes: the boxes.
        model: for drawing the previews; None to use photos and points.
    """
    known = common_options(scene, boxes)
    unused = ("method", "count", "seed", "test_every")
    values = {key: value for key, value in known.items() if key not in unused}
    values["count"] = scene_props(scene).suggested
    if model is not None:
        values |= {"model": str(model), "device": settings.get().device}
    if folder := masks.in_run(run_folders.run_folder(scene)):
        values["object_masks"] = str(folder)
    return _write(scene, own_files.SUGGEST_OPTIONS, boxes, values)


def write_train_options(
    scene: bpy.types.Scene, boxes: list[bpy.types.Object], preview_seconds: float
) -> Path:
    """Write the options file of `train`, or of `run` with test photos; return its path."""
    values = (
        common_options(scene, boxes)
        | _training_settings(scene)
        | {
            "preview_seconds": preview_seconds,
            "device": settings.get().device,
            "update": True,
        }
    )
    if settings.cluster():  # its machines have other numbers of cores
        values.pop("threads", None)
    if values["test_every"]:
        values["compare"] = []
    if chosen := usable_lists(scene, boxes):
        values["selection"] = str(_write_selections(scene, chosen))
    return _write(scene, own_files.TRAIN_OPTIONS, boxes, values)


def _write(
    scene: bpy.types.Scene, name: str, boxes: list[bpy.types.Object], values: dict[str, Any]
) -> Path:
    folder = own_folder(scene)
    path = folder / name
    _refuse_others(path, "scene")
    with writing(folder, "Run Folder"):
        values["rois"] = str(rois.write(folder, boxes, scene))
        files.write_json(path, values)
    return path


def own_folder(scene: bpy.types.Scene) -> Path:
    """Return the add-on's own folder in the scene's run folder, created if it is missing.

    Raises:
        AddonError: it cannot be created, or is a link.
    """
    return made_folder(run_folders.settle(scene), own_files.OWN)


def usable_lists(
    scene: bpy.types.Scene, boxes: list[bpy.types.Object]
) -> dict[bpy.types.Object, list[str]]:
    """Return box -> photos in its list without excluded ones, for boxes with such photos."""
    unused = set(exclusions.excluded(scene))
    lists = {box: [item.name for item in object_props(box).selection] for box in boxes}
    usable = {box: [n for n in names if n not in unused] for box, names in lists.items()}
    return {box: names for box, names in usable.items() if names}


def _write_selections(scene: bpy.types.Scene, lists: dict[bpy.types.Object, list[str]]) -> Path:
    """Write these boxes' lists of photos; the engine selects for the other boxes."""
    folder = made_folder(own_folder(scene), own_files.MANUAL_SELECTION)
    with writing(folder, "Run Folder"):
        for old in folder.glob("*.json"):
            if not others.is_other(old, OF_A_LIST):
                old.unlink()
        for box, names in lists.items():
            path = folder / f"{rois.file_name(box)}.json"
            _refuse_others(path, *OF_A_LIST)
            files.write_json(path, {"roi": box.name, "names": names})
    return folder
