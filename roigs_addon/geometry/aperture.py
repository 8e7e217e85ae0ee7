"""Samples a camera's aperture; each sample gives a camera for a sharp picture. No bpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .frames import Matrix

GOLDEN = (np.sqrt(5) - 1) / 2
APART = 2.0  # pixels between neighbouring samples in the blur of distant objects
FEWEST, MOST = 8, 64


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """A thin lens with Blender's settings.

    Attributes:
        radius: of its opening, world units.
        focus: distance of the plane in focus, along the camera's axis.
        blades: sides of the opening; below 3, it is round.
        rotation: of the blades, radians.
        ratio: height divided by width of the opening (anamorphic lenses).
    """

    radius: float
    focus: float
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0

    def count(self, focal: float) -> int:
        """Return the number of samples for a picture with this focal length (pixels)."""
        blur = 2 * self.radius * focal / self.focus  # of objects at infinity, pixels
        return int(np.clip(np.ceil((blur / APART) ** 2), FEWEST, MOST))

    def points(self, count: int) -> Matrix:
        """(count, 2) places in the opening, to the right and up, world units; evenly spread.

        They form a spiral by the golden angle (Vogel 1979). Consecutive places are far apart, so
        that any run of them is evenly spread, such as the samples of one moment of a motion.
        """
        number = np.argsort((np.arange(count) * GOLDEN) % 1)
        radius = np.sqrt((number + 0.5) / count)
        angle = 2 * np.pi * GOLDEN * number
        if self.blades >= 3:
            # Blender's sides lie at the angles of a circle's points, not its corners.
            half = np.pi / self.blades
            radius = (
                radius * np.cos(half) / np.cos((angle - self.rotation + half) % (2 * half) - half)
            )
        places = np.stack([np.cos(angle) / self.ratio, np.sin(angle)], axis=1)
        return np.asarray(self.radius * radius[:, None] * places)

    def through(self, camera: dict[str, Any], point: Matrix) -> dict[str, Any]:
        """Return the camera of a picture through a point; objects in focus stay in place."""
        right, down = float(point[0]), -float(point[1])
        pose = np.array(camera["world_to_camera"], dtype=np.float64)
        pose[:2, 3] -= right, down
        return {
            **camera,
            "cx": camera["cx"] + camera["fx"] * right / self.focus,
            "cy": camera["cy"] + camera["fy"] * down / self.focus,
            "world_to_camera": pose.tolist(),
        }
