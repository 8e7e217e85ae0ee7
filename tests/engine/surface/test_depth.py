"""The depth of Gaussians that are a surface."""

from __future__ import annotations

import numpy as np

from roigs_engine.surface.depth import _rendered
from tests.engine.surface.ball import CAMERA, discs, images, rays_hit


def test_it_follows_the_slant_of_each_gaussian() -> None:
    image = images()[7]
    found = _rendered(discs(), image, (0, 0, CAMERA.width, CAMERA.height))
    depth, _ = rays_hit(image)
    shown = (found.depth > 0) & ~np.isnan(depth)
    assert shown.sum() > 0.95 * (~np.isnan(depth)).sum()
    off = np.abs(found.depth - depth)[shown]
    assert np.median(off) < 0.002  # of centres: 0.009
