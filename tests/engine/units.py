"""The same scene in other units and at another place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene


def in_units(
    scene: SfmScene, roi: OrientedBox, scale: float, shift: float = 0.0
) -> tuple[SfmScene, OrientedBox]:
    """The scene and its box with all lengths multiplied, then moved along all three axes."""
    offset = np.full(3, shift)

    def moved(rigid: np.ndarray) -> np.ndarray:
        result = rigid.copy()
        result[:3, 3] = rigid[:3, 3] * scale - rigid[:3, :3] @ offset
        return result

    images = [replace(i, world_to_camera=moved(i.world_to_camera)) for i in scene.images]
    box = replace(roi, world_to_box=moved(roi.world_to_box), half_extents=roi.half_extents * scale)
    return replace(scene, images=tuple(images), points=scene.points * scale + offset), box
