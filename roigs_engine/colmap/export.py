"""Exports the cameras and points of a scene as JSON and NumPy files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..formats.files import atomic_write, write_json
from ..model.scene import Float64, PosedImage, SfmScene
from .inspect import inspect_scene

SCENE = "scene.json"
COLMAP, PLACED = "colmap", "placed"
"""Frames."""


def write_export(
    scene: SfmScene, folder: Path, *, placement: Float64 | None = None, frame: str = COLMAP
) -> dict[str, str]:
    """Write the scene's files to `folder`; returns name -> path.

    scene.json: the keys of `inspect_scene`, and `images`, one record each (docs/files.md).
    points.npy (P, 3) float32, colors.npy (P, 3) uint8.
    observed.npy (M,) int32: rows of points, ordered by photo. observed_starts.npy (V + 1,) int64:
    photo k observes the points observed[starts[k]:starts[k + 1]].

    Args:
        scene: to write.
        folder: to write to.
        placement: (4, 4) from the COLMAP frame to the world, if the project has one.
        frame: that of the scene, COLMAP or PLACED.
    """
    starts = np.cumsum([0, *(len(image.point_indices) for image in scene.images)])
    rows = [image.point_indices for image in scene.images]
    arrays: dict[str, NDArray[Any]] = {
        "points": scene.points.astype(np.float32),
        "colors": scene.colors,
        "observed": np.concatenate([np.empty(0, np.int64), *rows]).astype(np.int32),
        "observed_starts": starts.astype(np.int64),
    }
    for name, array in arrays.items():
        with atomic_write(folder / f"{name}.npy") as file:
            np.save(file, array, allow_pickle=False)
    record = inspect_scene(scene)
    del record["rois"]
    record["frame"] = frame
    record["placement"] = None if placement is None else placement.tolist()
    write_json(folder / SCENE, {**record, "images": [_image_record(i) for i in scene.images]})
    files = {"scene": SCENE, **{name: f"{name}.npy" for name in arrays}}
    return {name: str(folder / file) for name, file in files.items()}


def _image_record(image: PosedImage) -> dict[str, object]:
    camera = image.camera
    return {
        "name": image.name,
        "path": str(image.path.absolute()),
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "world_to_camera": image.world_to_camera.tolist(),
        "distorted": image.distorted,
    }
