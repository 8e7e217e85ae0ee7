"""Where to look from, when a model comes without its photos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.scene import Float64
from .arrays import Arrays, opacities

FIELD = 50.0  # degrees; the viewer's vertical field of view
ROOM = 1.1  # around what is looked at
ELEVATION = 20.0  # degrees above the horizon
DIRECTIONS = 24
SAMPLE = 100_000  # Gaussians that are looked at, at most
CORE = 1.5  # median distances from the middle that an overview shows: not all of a background


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """What to look at: everything within `radius` of `centre` (3,)."""

    centre: Float64
    radius: float


def overview(arrays: Arrays) -> Ball:
    """A ball around most of a model."""
    means = arrays["means"].astype(np.float64)
    middle = np.median(means, axis=0)
    radius = CORE * float(np.median(np.linalg.norm(means - middle, axis=1)))
    return Ball(centre=middle, radius=radius or 1.0)


def viewpoint(arrays: Arrays, ball: Ball) -> Float64:
    """(3,) position, y up, that sees the ball with little before it and much behind it.

    Photos are taken through free space, and show what is behind: the side without background is
    mostly one that no photo shows.
    """
    distance = ROOM * ball.radius / np.sin(np.radians(FIELD / 2))
    step = max(1, len(arrays["means"]) // SAMPLE)
    means = arrays["means"][::step].astype(np.float64) - ball.centre
    some = {name: values[::step] for name, values in arrays.items()}
    sizes = np.sort(np.exp(some["log_scales"].astype(np.float64)), axis=1)
    areas = opacities(some) * sizes[:, 1] * sizes[:, 2] * step
    rise = np.radians(ELEVATION)
    best, least = np.zeros(3), np.inf
    for angle in np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS:
        towards = np.array(
            [np.cos(rise) * np.sin(angle), np.sin(rise), np.cos(rise) * np.cos(angle)]
        )
        depth = distance - means @ towards  # from the camera
        across = np.linalg.norm(means - np.outer(means @ towards, towards), axis=1)
        seen = (depth > 0) & (across < ball.radius * depth / distance)
        solid = np.where(seen, areas / np.maximum(depth, 0.05 * distance) ** 2, 0.0)
        angles = np.pi * (ball.radius / distance) ** 2  # that the ball fills
        before = solid[depth < distance - ball.radius].sum() / angles
        behind = solid[depth > distance + ball.radius].sum() / angles
        cost = before - 0.5 * min(1.0, behind)
        if cost < least:
            best, least = towards, cost
    position: Float64 = ball.centre + distance * best
    return position
