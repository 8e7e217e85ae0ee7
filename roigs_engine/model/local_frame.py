"""The frame for training and rendering, independent of a model's units and origin.

Constants with a length (the near plane, smallest scales) and the resolution of float32 would
otherwise make a result depend on whether a scene is in millimetres, metres or map coordinates. So
every trainer of splats normalises scenes. Here the conversion is exact: the scale is a power of 16,
the origin a multiple of a power of two. For an ordinary model they are 1 and 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .roi import OrientedBox
from .scene import Float64, SfmScene

BASE = 16.0  # a scene's extent in its local frame is from 1 to BASE
FAR = 1000.0  # local units; closer, float32 resolves a fraction of a pixel
STEP = 64.0  # local units; the origin is a multiple of this


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalFrame:
    """A frame with local = (world - origin) * scale.

    Attributes:
        origin: (3,) world units.
        scale: local units per world unit.
    """

    origin: Float64
    scale: float

    @classmethod
    def world(cls) -> LocalFrame:
        """The frame in which local and world coordinates are the same."""
        return cls(origin=np.zeros(3), scale=1.0)

    @classmethod
    def around(cls, points: Float64, extent: float) -> LocalFrame:
        """The frame for points (N, 3) that are about `extent` apart, world units."""
        if not (len(points) and 0 < extent < math.inf):
            return cls.world()
        exponent = (math.frexp(extent)[1] - 1) // 4  # floor of the logarithm to base 16
        scale = BASE**-exponent
        middle, step = np.median(points, axis=0), STEP / scale
        far = np.abs(middle).max() * scale > FAR
        origin = np.round(middle / step) * step if far else np.zeros(3)
        return cls(origin=origin, scale=scale)

    @classmethod
    def of_scene(cls, scene: SfmScene) -> LocalFrame:
        """The frame for a scene, from its cameras."""
        return cls.around(scene.centres(), scene.extent())

    @classmethod
    def of_centres(cls, means: Float64) -> LocalFrame:
        """The frame for Gaussians without cameras, from centres (N, 3); ignores NaN and Inf."""
        good = means[np.isfinite(means).all(axis=1)]
        if len(good) == 0:
            return cls.world()
        with np.errstate(over="ignore"):  # overflow in a damaged file: the frame is then the world
            distances = np.linalg.norm(good - np.median(good, axis=0), axis=1)
        return cls.around(good, float(np.median(distances)))

    @property
    def is_world(self) -> bool:
        """Whether local and world coordinates are the same."""
        return self.scale == 1 and not self.origin.any()

    def points(self, world: Float64) -> Float64:
        """(N, 3) world positions -> local ones."""
        return np.asarray((world - self.origin) * self.scale)

    def transform(self, rigid: Float64) -> Float64:
        """Rigid transform (4, 4) from the world (`world_to_camera`, `world_to_box`) -> from here.

        Lengths in its target frame become local units, too.
        """
        if self.is_world:
            return rigid
        moved = rigid.copy()
        moved[:3, 3] = (rigid[:3, :3] @ self.origin + rigid[:3, 3]) * self.scale
        return moved

    def box(self, roi: OrientedBox) -> OrientedBox:
        """The box in this frame."""
        if self.is_world:
            return roi
        return replace(
            roi,
            world_to_box=self.transform(roi.world_to_box),
            half_extents=roi.half_extents * self.scale,
        )

    def scene(self, scene: SfmScene) -> SfmScene:
        """The scene in this frame."""
        if self.is_world:
            return scene
        images = tuple(
            replace(image, world_to_camera=self.transform(image.world_to_camera))
            for image in scene.images
        )
        return replace(scene, images=images, points=self.points(scene.points))
