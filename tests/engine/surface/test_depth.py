"""The depth of Gaussians that are a surface."""

from __future__ import annotations

import numpy as np
import torch

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.surface.depth import _rendered
from tests.engine.surface.ball import CAMERA, RADIUS, images, rays_hit

DISCS, SIZE = 3000, 0.02  # size: standard deviation, a pixel and a half


def discs() -> Gaussians:
    """Flat Gaussians on the ball (a Fibonacci sphere)."""
    k = np.arange(DISCS) + 0.5
    z, angle = 1 - 2 * k / DISCS, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    normals = torch.from_numpy(np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1))
    halfway = torch.nn.functional.normalize(normals + torch.tensor([0.0, 0.0, 1.0]), dim=1)
    turns = torch.cat([torch.zeros(DISCS, 1), halfway], dim=1)  # half a turn, z to the normal
    return Gaussians(
        means=(RADIUS * normals).float(),
        quats=turns.float(),
        log_scales=torch.tensor([SIZE, SIZE, SIZE / 100]).log().expand(DISCS, 3).contiguous(),
        logit_opacities=torch.full((DISCS,), 3.0),
        sh=torch.zeros(DISCS, 1, 3),
    )


def test_it_follows_the_slant_of_each_gaussian() -> None:
    image = images()[7]
    found = _rendered(discs(), image, (0, 0, CAMERA.width, CAMERA.height))
    depth, _ = rays_hit(image)
    shown = (found.depth > 0) & ~np.isnan(depth)
    assert shown.sum() > 0.95 * (~np.isnan(depth)).sum()
    off = np.abs(found.depth - depth)[shown]
    assert np.median(off) < 0.002  # of centres: 0.009
