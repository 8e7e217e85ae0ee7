"""A model for levels of detail: a ball with stripes."""

from __future__ import annotations

import numpy as np

from roigs_engine.model.gaussians import Gaussians


def cloud(count: int, seed: int, *, size: float = 0.5, shift: float = 0.0) -> Gaussians:
    """Small opaque Gaussians on a ball with soft stripes."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(count, 3))
    places *= size / np.linalg.norm(places, axis=1, keepdims=True)
    places[:, 0] += shift
    stripes = 128 + 100 * np.sin(6 * places / size + rng.uniform(0, 6, 3))
    model = Gaussians.from_points(places, stripes.astype(np.uint8))
    model.log_scales.fill_(float(np.log(size * 1.5 / np.sqrt(count))))
    model.logit_opacities.fill_(2.0)
    return model
