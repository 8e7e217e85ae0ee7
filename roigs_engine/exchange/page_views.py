"""Viewpoints for a model that comes without its photos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.scene import Float64
from .arrays import Arrays, opacities

FIELD = 50.0  # degrees; the viewer's vertical field of view
MARGIN = 1.1  # around what is looked at
ELEVATION = 20.0  # degrees above the horizon
DIRECTIONS = 24
AIMED = 20.0  # degrees from a photo's middle to what it looks at
PHOTOS = 60  # that are compared, at most
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


def photographed(poses: Float64) -> Ball | None:
    """A ball that a picture from the photos' usual distance shows; None if they share no middle.

    `poses` are (N, 4, 4) world_to_camera, OpenCV axes.
    """
    eyes, forwards = _eyes(poses), poses[:, 2, :3]
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    # The point nearest to the lines of sight.
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, eyes), rcond=0.01)
    centre: Float64 = middle[0]
    depths = ((centre - eyes) * forwards).sum(axis=1)
    if np.median(depths) <= 0:
        return None
    distance = float(np.median(np.linalg.norm(centre - eyes, axis=1)))
    return Ball(centre=centre, radius=distance * np.sin(np.radians(FIELD / 2)) / MARGIN)


def _eyes(poses: Float64) -> Float64:
    found: Float64 = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return found


def photo_directions(poses: Float64, ball: Ball) -> Float64:
    """(K, 3) directions from the ball to the photos that look at it, evenly chosen of many."""
    away = _eyes(poses) - ball.centre
    lengths = np.linalg.norm(away, axis=1)
    away /= np.maximum(lengths, 1e-30)[:, None]
    aimed = -(away * poses[:, 2, :3]).sum(axis=1) > np.cos(np.radians(AIMED))
    found: Float64 = away[aimed & (lengths > ball.radius)]
    return found[:: -(-len(found) // PHOTOS)] if len(found) else found


def _ring() -> Float64:
    """Directions all around, from a little above."""
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    rise = np.full(DIRECTIONS, np.radians(ELEVATION))
    return np.column_stack(
        (np.cos(rise) * np.sin(angles), np.sin(rise), np.cos(rise) * np.cos(angles))
    )


def viewpoint(arrays: Arrays, ball: Ball, poses: Float64 | None = None) -> Float64:
    """(3,) position, y up, that sees the ball with little before it and much behind it.

    Photos are taken through free space, and show what is behind: the side without background is
    mostly one that no photo shows. With the photos' `poses`, it is on the side of one of those
    that look at the ball.
    """
    directions = _ring() if poses is None else photo_directions(poses, ball)
    if not len(directions):
        directions = _ring()
    distance = MARGIN * ball.radius / np.sin(np.radians(FIELD / 2))
    step = max(1, len(arrays["means"]) // SAMPLE)
    means = arrays["means"][::step].astype(np.float64) - ball.centre
    some = {name: values[::step] for name, values in arrays.items()}
    sizes = np.sort(np.exp(some["log_scales"].astype(np.float64)), axis=1)
    areas = opacities(some) * sizes[:, 1] * sizes[:, 2] * step
    best, least = np.zeros(3), np.inf
    for towards in directions:
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
