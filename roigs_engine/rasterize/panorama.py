"""Panoramas from pinhole pictures in all directions, sampled along each pixel's ray.

This is like an environment map of a cube's faces (Greene 1986), but with narrower, overlapping
views.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import grid_sample

from ..cuda.device import CPU
from ..model.scene import Camera, Float64
from .instances import NOTHING, Instance, Layer, render_instances
from .light import to_linear, to_srgb

FINER = 1.5
"""Pixels in the middle of a view per pixel of the panorama."""
LARGEST = 4096  # most pixels per radian
SLOPE = math.tan(math.radians(30))
"""Slope from the middle of a view to its edges. In wider views, large Gaussians beside them look
stretched, unlike in training."""
RINGS = ((-67.5, 4), (-22.5, 8), (22.5, 8), (67.5, 4))
"""Latitudes of the views' middles in degrees, and number of views around. Each ray meets one."""
SHARPNESS = 2
"""Overlapping views are mixed by this power of a ray's distance from their edges."""


@torch.no_grad()
def render_panorama(
    models: Sequence[Instance],
    rays: Tensor,
    density: float,
    world_to_camera: Float64,
    device: torch.device = CPU,
    *,
    mattes: bool = False,
) -> Layer:
    """Render models together along rays from one point; views that no ray meets are not drawn.

    Args:
        models: they need at least one Gaussian in all.
        rays: (H, W, 3) float32 directions in the camera's frame, of any length; 0 for an empty
            pixel.
        density: largest number of the panorama's pixels per radian.
        world_to_camera: (4, 4) rigid.
        device: to draw on.
        mattes: also return the share of each object index.

    Returns:
        A layer whose depths are distances from the camera.
    """
    height, width = rays.shape[:2]
    directions = rays.reshape(-1, 3)
    focal = min(LARGEST, density * FINER)
    side = math.ceil(2 * focal * SLOPE)
    lens = Camera(width=side, height=side, fx=focal, fy=focal, cx=side / 2, cy=side / 2)
    found = {model.object_index for model in models if len(model.gaussians)}
    indices = sorted(found) if mattes else []
    light = torch.zeros(len(directions), 4 + len(indices))
    shares = torch.zeros(len(directions))
    depth, most = torch.full((len(directions),), NOTHING), torch.zeros(len(directions))
    for turn in _turns():
        seen = directions @ torch.from_numpy(turn[:3, :3].T).float()
        beside = seen[:, :2].abs().amax(dim=1) / seen[:, 2].clamp(min=1e-9)
        rows = (beside < SLOPE).nonzero()[:, 0]
        if not len(rows):
            continue
        seen, share = seen[rows], (1 - beside[rows] / SLOPE) ** SHARPNESS
        layer = render_instances(models, lens, turn @ world_to_camera, device, mattes=mattes)
        places = seen[:, :2] / seen[:, 2:] * focal + side / 2
        light[rows] += share[:, None] * _looked_up(layer, indices, 2 * places / side - 1)
        shares[rows] += share
        columns, lines = places.long().clamp(0, side - 1).unbind(dim=1)
        along = layer.depth[lines, columns]
        distance = torch.where(along < NOTHING, along * seen.norm(dim=1) / seen[:, 2], NOTHING)
        depth[rows] = torch.where(share > most[rows], distance, depth[rows])
        most[rows] = torch.maximum(share, most[rows])
    light /= shares.clamp(min=1e-12)[:, None]
    alpha = light[:, 3].clamp(0, 1)
    image = to_srgb(light[:, :3] / alpha.clamp(min=1e-6)[:, None]).clamp(0, 1)
    return Layer(
        image=image.reshape(height, width, 3),
        alpha=alpha.reshape(height, width),
        depth=depth.reshape(height, width),
        shares={i: light[:, 4 + k].reshape(height, width) for k, i in enumerate(indices)},
    )


def _looked_up(layer: Layer, indices: Sequence[int], places: Tensor) -> Tensor:
    """(N, 4 + K) values of a layer at places (N, 2) from -1 to 1.

    They are linear light times alpha, alpha, and the shares of K indices.
    """
    light = (to_linear(layer.image) * layer.alpha[..., None]).permute(2, 0, 1)
    shares = [layer.shares[index] for index in indices]
    picture = torch.cat([light, torch.stack([layer.alpha, *shares])])
    found = grid_sample(picture[None], places[None, None], align_corners=False)
    return found[0, :, 0].T


def _turns() -> Iterator[Float64]:
    """Yield (4, 4) from the camera's frame to each view's."""
    for latitude, count in RINGS:
        for k in range(count):
            turn = np.eye(4)
            around = Rotation.from_euler("YX", [360 * k / count, latitude], degrees=True)
            turn[:3, :3] = around.as_matrix().T
            yield turn
