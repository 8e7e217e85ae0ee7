"""A scene as it was placed in Blender: upright, in metres, where its user wants it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..formats.scene_transform import read_transforms, transform_among, transform_file
from ..formats.transforms import scale_of
from ..model.scene import Float64, SfmScene


def stored_placement(folder: Path, scene: SfmScene) -> Float64:
    """(4, 4) similarity from the COLMAP frame to the world, of the file beside the model.

    Args:
        folder: of the project, or of the model.
        scene: the model.

    Raises:
        ConfigError: there is none of this model, or the file is damaged.
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


def placed(scene: SfmScene, matrix: Float64) -> SfmScene:
    """The scene after a similarity (4, 4); photos stay what they are."""
    scale = scale_of(matrix)
    linear, offset = matrix[:3, :3], matrix[:3, 3]

    def moved(pose: Float64) -> Float64:
        after = np.eye(4)
        after[:3, :3] = pose[:3, :3] @ linear.T / scale
        after[:3, 3] = scale * pose[:3, 3] - after[:3, :3] @ offset
        return after

    images = tuple(replace(i, world_to_camera=moved(i.world_to_camera)) for i in scene.images)
    return replace(scene, images=images, points=scene.points @ linear.T + offset)
