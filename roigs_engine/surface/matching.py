"""Depth along a photo's rays at which other photos look alike: multi-view stereo.

A plane sweep (Collins 1996; Gallup et al. 2007) around a depth that is known roughly: each step
moves the whole known surface along the rays, so patches keep its shape and slant. Likeness is the
normalised cross-correlation of patches. A parabola through its peak gives fractions of a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from ..model.scene import Camera

LEAST_CONTRAST = 0.008
"""Standard deviation of a patch, of 1: where it is lower, noise decides."""
OCCLUSION = 0.04  # of the depth: what lies so much behind another photo's surface is hidden
LEAST_SEEN = 0.5  # of a patch


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """The part of a photo that shows the box.

    Attributes:
        camera: of the part.
        pose: (4, 4) float64 world_to_camera.
        grey: (h, w) in [0, 1].
        depth: (h, w) of the surface; 0: not known.
    """

    camera: Camera
    pose: Tensor
    grey: Tensor
    depth: Tensor

    def halved(self) -> Shot:
        """The same at half of the size."""
        height, width = (2 * (size // 2) for size in self.grey.shape)
        grey = functional.avg_pool2d(self.grey[None, None, :height, :width], 2)[0, 0]
        camera = self.camera
        half = Camera(
            width=width // 2,
            height=height // 2,
            fx=camera.fx / 2,
            fy=camera.fy / 2,
            cx=camera.cx / 2,
            cy=camera.cy / 2,
        )
        return Shot(camera=half, pose=self.pose, grey=grey, depth=self.depth[:height:2, :width:2])


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How a depth is searched for on one level of a pyramid.

    Attributes:
        level: photos are halved so many times.
        steps: to each side; each moves a point by `STEP` pixels in the other photos.
        radius: of a patch, pixels.
        likeness: least mean correlation of what is believed.
        smoothed: side of the median filter of the depth that is begun with.
    """

    level: int
    steps: int
    radius: int
    likeness: float
    smoothed: int


STEP = 0.5  # pixels, in the median over a photo
SWEEPS = (
    Sweep(level=2, steps=16, radius=3, likeness=0.4, smoothed=5),
    Sweep(level=1, steps=6, radius=3, likeness=0.45, smoothed=3),
    Sweep(level=0, steps=5, radius=4, likeness=0.5, smoothed=5),
)
ALONE = 0.15  # more likeness is asked for where only one other photo shows a patch
FILL = 4.0  # pixels: standard deviation of the blur that carries found depths to their neighbours
LEAST_FOUND, NEAR = 0.1, 0.05  # share of found pixels there; share of the depth it may change by
EDGE = 0.02  # of the depth: steps that a blur leaves as they are
BLUR = 1.5  # pixels


def matched(shots: Sequence[Shot], others: Sequence[Sequence[Shot]]) -> tuple[Tensor, Tensor]:
    """The depth at which a photo and others look alike, from coarse to fine.

    The rendered depth of a model without a surface is off by more than a patch's detail, and rough.
    So it is smoothed, and the search begins where pixels are large; what is found there fills its
    surroundings, where the next, finer search begins.

    Args:
        shots: the photo and its halves, a level of `SWEEPS` each, the whole one first.
        others: the same of each of the others.

    Returns:
        (H, W) depth; (H, W) mean correlation, 0 where the photos do not tell the depth.
    """
    depth = shots[-1].depth
    likeness = torch.zeros_like(depth)
    for sweep in SWEEPS:
        shot = shots[sweep.level]
        known = shot.depth > 0
        if depth.shape != known.shape:
            size = known.shape
            depth = functional.interpolate(depth[None, None], size=size, mode="nearest")[0, 0]
            depth = torch.where(known & (depth == 0), shot.depth, depth)
        begin = replace(shot, depth=_smoothed(depth * known, sweep.smoothed))
        depth, likeness = swept(begin, [levels[sweep.level] for levels in others], sweep)
        depth = _filled(depth, likeness > 0)
    return depth, likeness


def _smoothed(depth: Tensor, size: int) -> Tensor:
    """A depth without noise; its steps, and where it is not known, stay."""
    from scipy.ndimage import median_filter

    middle = torch.from_numpy(median_filter(depth.numpy(), size))
    middle = torch.where(middle > 0, middle, depth)
    known = (depth > 0).float()
    blurred = _blurred(middle * known, BLUR) / _blurred(known, BLUR).clamp(min=1e-6)
    smooth = torch.where((blurred - middle).abs() > EDGE * middle, middle, blurred)
    return smooth * known


def _filled(depth: Tensor, found: Tensor) -> Tensor:
    """Where nothing was found, the mean of what was found nearby, if that is near in depth."""
    share = _blurred(found.float(), FILL)
    mean = _blurred(depth * found, FILL) / share.clamp(min=1e-6)
    use = ~found & (depth > 0) & (share > LEAST_FOUND) & ((mean - depth).abs() < NEAR * depth)
    return torch.where(use, mean, depth)


def _blurred(values: Tensor, sigma: float) -> Tensor:
    from scipy.ndimage import gaussian_filter

    return torch.from_numpy(gaussian_filter(values.numpy(), sigma))


def rays(camera: Camera) -> Tensor:
    """(H, W, 3) directions of the pixels' centres in the camera's axes, with z = 1."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns, rows, torch.ones_like(rows)], dim=-1).float()


def seen_from(shot: Shot, other: Shot) -> tuple[Tensor, Tensor]:
    """The shot's rays (H, W, 3) in the other's axes, and its centre (3,) there."""
    relative = other.pose @ torch.linalg.inv(shot.pose)
    return rays(shot.camera) @ relative[:3, :3].T.float(), relative[:3, 3].float()


def projected(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """(..., 3) points in a camera's axes -> (..., 2) places in [-1, 1], and whether in the picture.

    The places are those of `grid_sample` without `align_corners`.
    """
    depth = points[..., 2].clamp(min=1e-9)
    x = (points[..., 0] / depth * camera.fx + camera.cx) * (2 / camera.width) - 1
    y = (points[..., 1] / depth * camera.fy + camera.cy) * (2 / camera.height) - 1
    inside = (points[..., 2] > 0) & (x.abs() < 1) & (y.abs() < 1)
    return torch.stack([x, y], dim=-1), inside


def sampled(values: Tensor, places: Tensor, mode: str = "bilinear") -> Tensor:
    """(h, w) values at places (N, H, W, 2) of `projected`: (N, H, W)."""
    count = len(places)
    picture = values[None, None].expand(count, 1, *values.shape)
    return functional.grid_sample(
        picture, places, mode=mode, padding_mode="border", align_corners=False
    )[:, 0]


def swept(shot: Shot, others: Sequence[Shot], sweep: Sweep) -> tuple[Tensor, Tensor]:
    """The shot's depth at which the others look most alike, and the likeness there.

    Returns:
        (H, W) depth, the shot's own where the photos do not tell it; (H, W) mean correlation, 0
        there.
    """
    known = shot.depth > 0
    motions = [_pixels_per_share(shot, other)[known] for other in others]
    middle = torch.cat(motions).median() if motions and known.any() else torch.tensor(0.0)
    if not float(middle) > 0:
        return shot.depth, torch.zeros_like(shot.depth)
    share = STEP / float(middle)
    factors = 1 + share * torch.arange(-sweep.steps, sweep.steps + 1).float()
    patches = _Patches(shot.grey, sweep.radius)
    total = torch.zeros(len(factors), *shot.depth.shape)
    count = torch.zeros_like(total)
    for other in others:
        likeness, seen = _likeness(shot, other, factors, patches)
        total += likeness * seen
        count += seen
    most = count.max(dim=0).values
    mean = torch.where((count == most) & (count > 0), total / count.clamp(min=1), -1.0)
    least = sweep.likeness + ALONE * (most < 2)
    return _peak(shot.depth, mean, known & patches.contrast, least, share)


def _peak(
    depth: Tensor, likeness: Tensor, usable: Tensor, least: Tensor, share: float
) -> tuple[Tensor, Tensor]:
    """The depth at the highest likeness (K, H, W), and that; see `swept`."""
    best, index = likeness.max(dim=0)
    inner = index.clamp(1, len(likeness) - 2)
    low, high = (likeness.gather(0, (inner + side)[None])[0] for side in (-1, 1))
    bend = 2 * best - low - high
    found = usable & (index == inner) & (best > least) & (bend > 1e-4)
    found &= (low > -1) & (high > -1)  # there, fewer photos show it
    fraction = (0.5 * (high - low) / bend.clamp(min=1e-4)).clamp(-0.5, 0.5)
    moved = depth * (1 + share * (inner - len(likeness) // 2 + fraction))
    return torch.where(found, moved, depth), torch.where(found, best, 0.0)


def _pixels_per_share(shot: Shot, other: Shot) -> Tensor:
    """(H, W) how many of the other's pixels a point moves if its depth changes by its own size."""
    directions, centre = seen_from(shot, other)
    points = shot.depth[..., None] * directions + centre
    depth = points[..., 2].clamp(min=1e-9)
    # The derivative of the projection along the ray; its part towards the camera is the centre's.
    across = (centre[:2] - points[..., :2] / depth[..., None] * centre[2]) / depth[..., None]
    moved: Tensor = torch.linalg.vector_norm(across, dim=-1)
    return moved * math.sqrt(other.camera.fx * other.camera.fy)


def _likeness(shot: Shot, other: Shot, factors: Tensor, patches: _Patches) -> tuple[Tensor, Tensor]:
    """(K, H, W) correlation with the other photo at each depth, and where it shows the patch."""
    directions, centre = seen_from(shot, other)
    points = (factors[:, None, None] * shot.depth)[..., None] * directions + centre
    places, inside = projected(points, other.camera)
    middle = len(factors) // 2
    behind = sampled(other.depth, places[middle : middle + 1], "nearest")[0]
    visible = (behind > 0) & (points[middle, ..., 2] < behind * (1 + OCCLUSION))
    return patches.likeness(sampled(other.grey, places), inside & visible & (shot.depth > 0))


class _Patches:
    """The patches around all pixels of a picture."""

    def __init__(self, grey: Tensor, radius: int) -> None:
        self._radius = radius
        self._grey = grey - grey.mean()
        mean, square = self._means(torch.stack([self._grey, self._grey**2])[None])[0]
        self.contrast = (square - mean**2).clamp(min=0).sqrt() > LEAST_CONTRAST

    def _means(self, values: Tensor) -> Tensor:
        """(N, C, H, W) means over each pixel's patch; zeros lie beyond the border."""
        from scipy.ndimage import uniform_filter  # takes a quarter of the time of torch's pooling

        size = (0, 0, 2 * self._radius + 1, 2 * self._radius + 1)
        return torch.from_numpy(uniform_filter(values.numpy(), size, mode="constant"))

    def likeness(self, values: Tensor, usable: Tensor) -> tuple[Tensor, Tensor]:
        """(K, H, W) correlation of other pictures with this one, over the usable pixels; and where.

        Both have the shape (K, H, W).
        """
        mask = usable.float()
        own, other = self._grey * mask, (values - 0.5) * mask
        stacked = torch.stack([mask, own, other, own * own, other * other, own * other], dim=1)
        part, a, b, aa, bb, ab = self._means(stacked).unbind(dim=1)
        whole = part.clamp(min=1e-3)
        a, b = a / whole, b / whole
        variance_a, variance_b = aa / whole - a * a, bb / whole - b * b
        product = (variance_a * variance_b).clamp(min=1e-9).sqrt()
        seen = (part > LEAST_SEEN) & usable
        return ((ab / whole - a * b) / product).clamp(-1, 1), seen.float()
