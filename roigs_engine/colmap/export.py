"""Exports a scene's cameras and points as JSON and NumPy files, in either frame."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..formats.files import atomic_write, write_json
from ..formats.scene_transform import read_transforms, transform_among, transform_file
from ..formats.transforms import scale_of
from ..model.scene import Float64, SfmScene
from ..photos.rotation import AS_STORED
from .inspect import inspect_scene
from .shown_photo import is_as_stored

SCENE = "scene.json"
COLMAP, PLACED = "colmap", "placed"
"""Frames of an export: of the COLMAP model, or of the world."""


def write_export(
    scene: SfmScene, folder: Path, *, transform: Float64 | None = None, frame: str = COLMAP
) -> dict[str, str]:
    """Write the scene's files to `folder`; returns name -> path.

    scene.json: the keys of `inspect_scene`, and `images` with one record each (docs/files.md).
    points.npy (P, 3) float32, colors.npy (P, 3) uint8.
    observed.npy (M,) int32: rows of points, ordered by photo. observed_starts.npy (V + 1,) int64:
    photo k observes the points observed[starts[k]:starts[k + 1]].

    Args:
        transform: (4, 4) from the COLMAP frame to the world, if the project has one.
        frame: the scene's frame, COLMAP or PLACED.
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
    record["placement"] = None if transform is None else transform.tolist()
    record["images"] = [
        {
            "name": image.name,
            "path": str(image.path.absolute()),
            **asdict(image.camera),
            "world_to_camera": image.world_to_camera.tolist(),
            "distorted": image.distorted,
            "lens": image.lens,
            "turn": image.turn,
            "as_stored": not image.lens and image.turn == AS_STORED and is_as_stored(image.path),
        }
        for image in scene.images
    ]
    write_json(folder / SCENE, record)
    files = {"scene": SCENE, **{name: f"{name}.npy" for name in arrays}}
    return {name: str(folder / file) for name, file in files.items()}


def stored_transform(folder: Path, scene: SfmScene) -> Float64:
    """Read the (4, 4) similarity from the COLMAP frame to the world, stored with the project.

    ConfigError: there is none for this model, or the file is damaged.
    """
    path = transform_file(folder)
    stored = read_transforms(path)
    if not stored:
        raise ConfigError(f"There is no {path}.", "Place the scene in Blender first.")
    found = transform_among(stored, {image.name: image.centre for image in scene.images})
    if found is None:
        raise ConfigError(
            f"{path} is not of this model: its cameras are elsewhere.",
            "Place the scene in Blender again.",
        )
    return found.matrix


def transformed(scene: SfmScene, matrix: Float64) -> SfmScene:
    """The scene after a similarity (4, 4); photos do not change."""
    scale = scale_of(matrix)
    linear, offset = matrix[:3, :3], matrix[:3, 3]

    def moved(pose: Float64) -> Float64:
        after = np.eye(4)
        after[:3, :3] = pose[:3, :3] @ linear.T / scale
        after[:3, 3] = scale * pose[:3, 3] - after[:3, :3] @ offset
        return after

    images = tuple(replace(i, world_to_camera=moved(i.world_to_camera)) for i in scene.images)
    return replace(scene, images=images, points=scene.points @ linear.T + offset)
