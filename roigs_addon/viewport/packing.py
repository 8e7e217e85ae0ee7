"""Packs several clouds into texel arrays for `shaders/splat.vert.glsl`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..geometry.splat_cloud import SplatCloud
from ..shared import targets

Float32 = NDArray[np.float32]

ROW = 8192
"""Texels in a row of every texture; all GPUs that Blender supports allow twice as many."""

GEOMETRY_TEXELS = 3
"""Texels of a Gaussian's shape: mean and opacity; quaternion; scales and its object's number.

With anti-aliasing, the number is half a one larger.
"""

INDEX_MARK = np.uint32(0x40000000)
"""Bit set in every stored index.

Blender's Python can fill textures only with floats, so the bits of an index are stored as a float.
As float32 numbers, indices above 2^24 would be rounded. As plain bits, small ones would be
denormal, which GPUs may treat as 0. With this bit, every index below 2^29 is a normal float.
"""


@dataclass(frozen=True, eq=False)
class PackedSet:
    """N Gaussians of several clouds, one cloud after another.

    Attributes:
        means: (N, 3), each in its object's frame.
        ranges: first and end row of each cloud.
        extent: root of the mean squared distance of the means from their objects' origins.
        geometry: (rows, ROW, 4), `GEOMETRY_TEXELS` texels per Gaussian.
        colours: (rows, ROW, 4), 3 * `sh_texels` texels per Gaussian: the coefficients of red, of
            green, of blue, each filled up with zeros to whole texels.
        sh_texels: 1, 3 or 4.
        lights: whether each cloud is blended in linear light, not as sRGB values.
        photo_focals: `SplatCloud.photo_focal` of each cloud; 0 if unknown.
    """

    means: Float32
    ranges: tuple[tuple[int, int], ...]
    extent: float
    geometry: Float32
    colours: Float32
    sh_texels: int
    lights: tuple[bool, ...]
    photo_focals: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.means)

    @property
    def rows(self) -> int:
        """Height of the larger array."""
        return max(len(self.geometry), len(self.colours))


def pack(clouds: Sequence[SplatCloud]) -> PackedSet:
    """Pack the clouds into one set; the k-th belongs to object k."""
    ends = np.cumsum([0, *(len(cloud) for cloud in clouds)]).tolist()
    ranges = tuple(pairwise(ends))
    count = ends[-1]
    sh_texels = max((-(-cloud.sh.shape[1] // 4) for cloud in clouds), default=1)
    geometry, by_gaussian = _texels(count, GEOMETRY_TEXELS)
    colours, sh = _texels(count, 3 * sh_texels)
    sh = sh.reshape(count, 3, 4 * sh_texels)
    for number, (cloud, (start, stop)) in enumerate(zip(clouds, ranges, strict=True)):
        part = by_gaussian[start:stop]
        part[:, 0, :3], part[:, 0, 3] = cloud.means, cloud.opacities
        part[:, 1] = cloud.quats
        narrow = cloud.target.blur < targets.BLUR
        flags = 0.5 * cloud.antialiased + 0.25 * narrow
        part[:, 2, :3], part[:, 2, 3] = cloud.scales, number + flags
        sh[start:stop, :, : cloud.sh.shape[1]] = cloud.sh.transpose(0, 2, 1)
    means = np.ascontiguousarray(by_gaussian[:, 0, :3])
    extent = float(np.sqrt(np.square(means).sum(axis=1).mean(dtype=float))) if count else 1.0
    lights = tuple(cloud.target.linear_light for cloud in clouds)
    focals = tuple(cloud.photo_focal or 0.0 for cloud in clouds)
    return PackedSet(means, ranges, extent, geometry, colours, sh_texels, lights, focals)


def pack_order(order: NDArray[np.uint32]) -> Float32:
    """Convert indices to texels (rows, ROW), marked with `INDEX_MARK`."""
    texels = np.zeros((max(1, -(-len(order) // ROW)), ROW), np.uint32)
    texels.reshape(-1)[: len(order)] = order | INDEX_MARK
    return texels.view(np.float32)


def _texels(count: int, each: int) -> tuple[Float32, Float32]:
    """Create an array of whole rows of texels, and a view of it as (count, each, 4)."""
    rows = max(1, -(-count * each // ROW))
    texels = np.zeros((rows, ROW, 4), np.float32)
    return texels, texels.reshape(-1, 4)[: count * each].reshape(count, each, 4)
