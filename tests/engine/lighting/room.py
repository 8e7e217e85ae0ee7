"""A room of Gaussians: a grey sphere around us with patches of other colours."""

from __future__ import annotations

import numpy as np

from roigs_engine.model.gaussians import SH_C0, Gaussians

COUNT, RADIUS = 3000, 4.0
GREY = 0.5  # sRGB


def ball_around(count: int = COUNT) -> np.ndarray:
    """(N, 3) unit vectors all around (a Fibonacci sphere)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def room(
    patches: dict[tuple[float, float, float], tuple[float, float, float]] | None = None,
    hole: tuple[float, float, float] | None = None,
) -> Gaussians:
    """The room; `patches`: direction -> sRGB colour of what is within 15 degrees of it."""
    ways = ball_around()
    colours = np.full((COUNT, 3), GREY)
    for way, colour in (patches or {}).items():
        colours[ways @ way > np.cos(np.radians(15))] = colour
    kept = np.ones(COUNT, bool) if hole is None else ways @ hole < np.cos(np.radians(30))
    count = int(kept.sum())
    return Gaussians.from_arrays(
        {
            "means": (RADIUS * ways[kept]).astype(np.float32),
            "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
            "log_scales": np.full((count, 3), np.log(0.12), np.float32),
            "logit_opacities": np.full(count, 6.0, np.float32),
            "sh": ((colours[kept] - 0.5) / SH_C0)[:, None].astype(np.float32),
        }
    )
