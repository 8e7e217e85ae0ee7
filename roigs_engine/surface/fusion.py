"""Fusion of depth maps into a truncated signed distance field (TSDF) of a box.

It follows Curless and Levoy (1996), with space carving: a ray that passes a voxel before its depth
votes that the voxel is free. Two additions are ours. If many more rays end far in front of a voxel
than near it, they vote weakly that it is inside. So wrong depths in a few photos make no layer
inside an object. Photos with larger pixels at the voxel have less weight. The field is computed
coarsely first, then finely near the coarse surface. Depth with a negative weight is not the
object's: space in front of it is free and, with little weight, so is space behind it.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..kernels import bindings
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64
from .depth import DepthMap

STAGE = "fusion"
COARSE = 4  # side of a cell of the coarse field, voxels
TRUNCATION = 3.0  # least truncation, voxels
FOOTPRINTS = 1.0  # .. and in pixels of the photo
HIDDEN = 0.1  # weight of a ray that ends in front of a voxel, relative to one that passes it
AGREED = 0.15  # .. this weight is 0 if at least so many rays, relative to these, end near the voxel
JUMP = 2.0  # most difference of neighbours' depths on one surface, in sizes of a pixel
BEHIND = 0.1  # weight with which space far behind other objects is free, relative to a ray's
STEEPEST = 0.15  # least cosine between normal and ray on a surface
SMOOTHING = 1.0  # standard deviation of the filter before slopes are measured, pixels
POINTS_AT_ONCE = 1 << 20
STEPS = 100
"""Steps of the stage. They are fixed because the number of fine parts is known late."""
COARSE_SHARE = 0.1
"""Share of the stage's progress for the coarse field."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """The distance field of a box on a grid, in the box's own axes.

    Attributes:
        distance: (X, Y, Z) in truncations, -1 to 1: positive in free space, negative inside.
        origin: (3,) the first voxel's centre in the box's axes.
        voxel: side of a voxel, units of the scene.
    """

    distance: Float32
    origin: Float64
    voxel: float

    @property
    def faces(self) -> int:
        """Return about how many faces the surface has: two for each grid edge that it crosses."""
        inside = self.distance < 0
        return 2 * sum(int(np.diff(inside, axis=k).sum()) for k in range(3))

    def halved(self) -> Field:
        """Return the field with voxels of twice the side: the means of 2 x 2 x 2 voxels."""
        pairs = [(0, size % 2) for size in self.distance.shape]
        x, y, z = (-(-size // 2) for size in self.distance.shape)
        cubes = np.pad(self.distance, pairs, mode="edge").reshape(x, 2, y, 2, z, 2)
        return Field(
            distance=cubes.mean(axis=(1, 3, 5)),
            origin=self.origin + self.voxel / 2,
            voxel=2 * self.voxel,
        )


def footprint(depth_map: DepthMap) -> float:
    """Return the size of a pixel on the surface at the median depth; infinite without any depth."""
    depth = depth_map.depth[depth_map.depth > 0]
    if not len(depth):
        return float("inf")
    return float(np.median(depth)) / max(depth_map.lens.fx, depth_map.lens.fy)


def fuse(
    maps: Sequence[DepthMap], roi: OrientedBox, voxel: float, context: Context = QUIET
) -> Field:
    """Make the field of a box from its depth maps.

    Args:
        maps: depth maps in the frame of the box.
        voxel: side of a voxel, units of the scene.
    """
    cells = np.maximum(np.ceil(2 * roi.half_extents / (COARSE * voxel)).astype(int), 1)
    low = -cells * (COARSE * voxel) / 2  # the box's corner, or just outside
    rays = [_Ray(depth_map, roi) for depth_map in maps if depth_map.depth.any()]
    context.emit(StageStarted(stage=STAGE, total=STEPS))
    started = time.monotonic()

    def tell(share: float) -> None:
        context.check_cancelled()
        if step := int(STEPS * share):
            context.progress(STAGE, step, STEPS, started)

    every = _grid(cells)
    side = COARSE * voxel
    sums = _sampled(
        low + (every + 0.5) * side, rays, side, lambda share: tell(COARSE_SHARE * share)
    )
    coarse, near = _field(sums).reshape(*cells), sums[:, 4].reshape(*cells) > 0
    active = every[np.flatnonzero(_active(coarse, near))]
    field = np.sign(coarse)
    for axis in range(3):
        field = field.repeat(COARSE, axis)
    offsets = _grid([COARSE] * 3)
    step = max(1, POINTS_AT_ONCE // len(offsets))
    for first in range(0, len(active), step):
        some = active[first : first + step]

        def part(share: float, first: int = first, some: NDArray[np.int64] = some) -> None:
            done = (first + share * len(some)) / len(active)
            tell(COARSE_SHARE + (1 - COARSE_SHARE) * done)

        index = (some[:, None] * COARSE + offsets).reshape(-1, 3)
        sums = _sampled(low + (index + 0.5) * voxel, rays, voxel, part)
        field[tuple(index.T)] = _field(sums)
    context.progress(STAGE, STEPS, STEPS, started)
    return Field(distance=field, origin=low + voxel / 2, voxel=voxel)


def _grid(sides: Sequence[int]) -> NDArray[np.int64]:
    """Return the places (N, 3) of a grid, the last axis fastest."""
    axes = np.meshgrid(*map(np.arange, sides), indexing="ij")
    return np.asarray(np.stack([axis.ravel() for axis in axes], axis=1), dtype=np.int64)


def _field(sums: Float32) -> Float32:
    """Return the field (N,) from sums of `roigs_fuse_depth`; -1 where no ray has come."""
    value, weight, near, hidden = sums[:, :4].T
    with np.errstate(all="ignore"):
        disagreed = np.clip(1 - near / (AGREED * hidden), 0, 1)
        hidden = np.where(hidden > 0, HIDDEN * hidden * disagreed, 0)
        field = (value - hidden) / (weight + hidden)
    return np.where(weight + hidden > 0, field, np.float32(-1)).astype(np.float32)


def _active(coarse: Float32, near: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells in which or beside which there may be a surface."""
    inside = coarse < 0
    mixed = ndimage.maximum_filter(inside, 3) & ~ndimage.minimum_filter(inside, 3)
    return np.asarray(mixed | ndimage.maximum_filter(near & (np.abs(coarse) < 0.9), 3))


def _sampled(
    points: Float64, rays: Sequence[_Ray], voxel: float, tell: Callable[[float], None]
) -> Float32:
    """Return the sums (N, 5) of `roigs_fuse_depth` at points (N, 3) in the box's axes.

    Args:
        points, rays: the points, and the depth maps to sum.
        voxel: distance between points.
        tell: called before each depth map with the share of this work that is done.
    """
    places = np.ascontiguousarray(points, dtype=np.float32)
    sums, beside = (np.zeros((len(points), 5), np.float32) for _ in range(2))
    for number, ray in enumerate(rays):
        tell(number / len(rays))
        for weight, total in ((ray.weight, sums), (ray.beside, beside)):
            if weight is None:
                continue
            photo = ray.photo(voxel, weight)
            bindings.kernels().roigs_fuse_depth(
                places.ctypes.data, len(places), ctypes.byref(photo), total.ctypes.data
            )
    sums[:, :2] += (beside[:, 1] + BEHIND * beside[:, 3])[:, None]
    return sums


class _Ray:
    """A depth map in the form that the kernel samples."""

    def __init__(self, depth_map: DepthMap, roi: OrientedBox) -> None:
        self.camera = depth_map.lens
        self.pose = depth_map.world_to_camera @ np.linalg.inv(roi.world_to_box)
        self.depth = np.ascontiguousarray(depth_map.depth, dtype=np.float32)
        self.slope, facing = slopes(self.depth, self.camera)
        size = np.maximum(self.depth / max(self.camera.fx, self.camera.fy), 1e-12)
        certain = depth_map.weight * facing * (self.depth > 0) / size**2
        self.weight = np.ascontiguousarray(certain.clip(min=0), dtype=np.float32)
        self.beside = None
        """Weights of depths that are not the object's."""
        if certain.min() < 0:
            self.beside = np.ascontiguousarray((-certain).clip(min=0), dtype=np.float32)

    def photo(self, voxel: float, weight: Float32) -> bindings.DepthPhoto:
        """Return the kernel's structure for points `voxel` apart; valid while this exists."""
        camera = self.camera
        pixel = 1 / max(camera.fx, camera.fy)
        pose = (ctypes.c_float * 12)(*self.pose[:3].ravel())
        lens = (ctypes.c_float * 4)(camera.fx, camera.fy, camera.cx, camera.cy)
        arrays = (a.ctypes.data for a in (self.depth, weight, self.slope))
        numbers = JUMP * pixel, TRUNCATION * voxel, FOOTPRINTS * pixel
        size = (ctypes.c_int32 * 2)(camera.width, camera.height)
        return bindings.DepthPhoto(*arrays, pose, lens, *numbers, size)


def slopes(depth: Float32, camera: Camera) -> tuple[Float32, Float32]:
    """Return slopes of the surface of a depth map, from the gradient of 1 / depth.

    Returns:
        (H, W) distance to the surface's plane per difference in depth; (H, W) cosine between the
        surface's normal and the ray.
    """
    with np.errstate(divide="ignore"):
        inverse = np.where(depth > 0, 1 / depth.astype(np.float64), 0.0)
    down, across = (
        ndimage.gaussian_filter(inverse, SMOOTHING, order=order, mode="nearest")
        for order in ((1, 0), (0, 1))
    )
    inverse = ndimage.gaussian_filter(inverse, SMOOTHING, mode="nearest")
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy)[:, None]
    across, down = across * camera.fx, down * camera.fy
    length = np.sqrt(across**2 + down**2 + (inverse - x * across - y * down) ** 2)
    slope = inverse / np.maximum(length, 1e-12)
    facing = slope / np.sqrt(1 + x**2 + y**2)
    slope[facing < STEEPEST] = 1.0  # between two surfaces, not on one
    return slope.astype(np.float32), facing.astype(np.float32)
