"""Plans the memory of a surface: resolution of its depth maps, field and texture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..formats.text import in_gb
from ..machine import ENGINE, machine_memory
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from .depth import box_window
from .fusion import COARSE

FINER = 2.0  # voxels in a pixel of the better photos
BETTER = 25  # percentile of the photos' pixels
MOST_VOXELS = 1 << 27
FIELD_SHARE = 4  # a field takes at most 1/4 of the machine's memory, ..
MAPS_SHARE = 8  # .. depth maps 1/8, ..
TEXTURE_SHARE = 4  # .. a texture 1/4, after the field
PER_VOXEL = 30  # bytes while a field is fused and cut out
PER_DEPTH = 20  # bytes for depth, weight, slope, and values computed from them
PER_TEXEL = 300  # bytes while it gets its colour
PER_PIXEL = 200  # bytes in the largest part of a photo: its colours, the mesh's depth there
PER_GAUSSIAN = 800  # bytes for parameters, and values computed for drawing
CHARTS = 150 << 20  # bytes for charts, and memory that reading the scene leaves in use
NEAR_ENOUGH = 1.5  # depth maps at most so many times finer than the field stay as they are


@dataclass(frozen=True, kw_only=True)
class SurfacePlan:
    """The memory plan of a surface.

    Attributes:
        coarser: size of the depth maps' pixels, in pixels of the photos.
        voxel: least side of a voxel, units of the scene.
        texture: largest side of the texture, texels.
        memory: about how many bytes are used at most.
        machine: bytes of memory of the machine.
    """

    coarser: float
    voxel: float
    texture: int
    memory: int
    machine: int

    @property
    def text(self) -> str:
        """Return the plan as one line for users."""
        return f"Memory: up to about {in_gb(self.memory)} of {in_gb(self.machine)}."


def plan_surface(images: Sequence[PosedImage], roi: OrientedBox, gaussians: int) -> SurfacePlan:
    """Plan the memory of a box's surface.

    Args:
        images: the photos that show the box.
        gaussians: number of Gaussians.
    """
    machine = machine_memory()
    most = min(MOST_VOXELS, machine // FIELD_SHARE // PER_VOXEL)
    volume = float(np.prod(2 * roi.half_extents))
    # Cells at the box's sides extend beyond the box.
    voxel = float((volume / most) ** (1 / 3)) * (1 + COARSE / 100)
    windows = [window for image in images if (window := box_window(roi, image)) is not None]
    areas = [(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in windows] or [0]
    pixels = [pixel_size(image, roi) for image in images]
    finest = float(np.percentile(pixels, BETTER)) / FINER if pixels else math.inf
    coarser = voxel / finest if voxel > NEAR_ENOUGH * finest else 1.0
    maps = sum(areas) * PER_DEPTH
    coarser = max(coarser, math.sqrt(maps / (machine / MAPS_SHARE)))
    maps = int(maps / coarser**2)
    side = math.isqrt(machine // TEXTURE_SHARE // PER_TEXEL)
    voxels = min(most, int(volume / max(finest, voxel) ** 3))
    photo = PER_PIXEL * max(areas)
    texture = min(PER_TEXEL * side**2, int(PER_TEXEL * voxels ** (2 / 3) * 6))
    work = maps + max(PER_VOXEL * voxels, texture + photo)
    return SurfacePlan(
        coarser=coarser,
        voxel=voxel,
        texture=1 << int(math.log2(side)),
        memory=ENGINE + CHARTS + PER_GAUSSIAN * gaussians + work,
        machine=machine,
    )


def pixel_size(image: PosedImage, roi: OrientedBox) -> float:
    """Return the size of a photo's pixel at a box's centre, units of the scene."""
    away = float(np.linalg.norm(image.centre - roi.centre))
    return away / max(image.camera.fx, image.camera.fy)
