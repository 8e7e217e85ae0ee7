"""What the add-on asks of the engine: request files and command lines from a scene's properties."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy

from . import preferences, regions, run_folders
from .errors import AddonError, writing


def request(scene: bpy.types.Scene, rois: list[bpy.types.Object]) -> dict[str, Any]:
    """The settings of selection and training, as a request file has them (docs/files.md).

    Raises:
        AddonError: something is missing.
    """
    settings = scene.roigs
    if not settings.colmap:
        raise AddonError("No COLMAP model is imported. Import one first.")
    if not Path(settings.colmap).is_dir():
        raise AddonError(
            f"The COLMAP folder {settings.colmap} is gone. Import it again from its new place."
        )
    if not rois:
        raise AddonError("There is no ROI. Add one around the object.")
    values: dict[str, Any] = {
        "scene": settings.colmap,
        "images": bpy.path.abspath(settings.images) or None,
        "max_side": settings.max_side,
        "method": settings.method,
        "count": settings.count or None,
        "seed": settings.seed,
        "threads": _threads(),
        "test_every": settings.test_every,
    }
    return {key: value for key, value in values.items() if value is not None}


def machine_options() -> list[str]:
    """What the preferences say of the machine, for a command that takes no request file."""
    threads = _threads()
    return ["--device", _device(), *([] if threads is None else ["--threads", str(threads)])]


def _threads() -> int | None:
    return getattr(preferences.get(), "threads", 0) or None


def _device() -> str:
    return str(getattr(preferences.get(), "device", "auto"))


def write_selection_request(scene: bpy.types.Scene, rois: list[bpy.types.Object]) -> Path:
    """Files for `select`; returns the request's path."""
    values = request(scene, rois)
    if not values["test_every"]:
        del values["test_every"]
    return _write(scene, "select.json", rois, values)


def write_training_request(
    scene: bpy.types.Scene, rois: list[bpy.types.Object], preview_seconds: float
) -> Path:
    """Files for `train`; returns the request's path."""
    values = request(scene, rois) | {
        "preset": scene.roigs.preset,
        "steps_factor": float(f"{scene.roigs.steps_factor:.5g}"),  # Blender's is a 32-bit number
        "strategy": scene.roigs.strategy,
        "preview_seconds": preview_seconds,
        "device": _device(),
        "update": True,
    }
    if any(len(roi.roigs.selection) for roi in rois):
        values["selection"] = str(_write_selections(scene, rois))
    return _write(scene, "train.json", rois, values)


def _write(
    scene: bpy.types.Scene, name: str, rois: list[bpy.types.Object], values: dict[str, Any]
) -> Path:
    folder = own_folder(scene)
    path = folder / name
    with writing(folder, "Run Folder"):
        values["rois"] = str(regions.write(folder, rois, scene))
        path.write_text(json.dumps(values, indent=1, ensure_ascii=False), encoding="utf-8")
    return path


def own_folder(scene: bpy.types.Scene) -> Path:
    """Files that the add-on gives to the engine, inside the run folder, which is made.

    Raises:
        AddonError: it cannot be.
    """
    folder = run_folders.settle(scene) / "blender"
    with writing(folder, "Run Folder"):
        folder.mkdir(exist_ok=True)
    return folder


def _write_selections(scene: bpy.types.Scene, rois: list[bpy.types.Object]) -> Path:
    """The photos of each box that has a list of its own; the engine selects for the others."""
    folder = own_folder(scene) / "selection"
    with writing(folder, "Run Folder"):
        folder.mkdir(exist_ok=True)
        for old in folder.glob("*.json"):
            old.unlink()
        for roi in rois:
            if len(roi.roigs.selection):
                names = [item.name for item in roi.roigs.selection]
                (folder / f"{regions.file_name(roi)}.json").write_text(
                    json.dumps({"roi": roi.name, "names": names}, ensure_ascii=False),
                    encoding="utf-8",
                )
    return folder


def selection_is_stale(roi: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Whether the box was moved after its photos were selected."""
    try:
        return roi.roigs.selected_box not in ("", regions.box_key(roi, scene))
    except AddonError:
        return True
