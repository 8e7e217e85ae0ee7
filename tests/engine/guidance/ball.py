"""A ball on a table with cameras around it: what each photo sees is known exactly."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene, project
from tests.poses import look_at

CAMERA = Camera(width=120, height=90, fx=110.0, fy=110.0, cx=60.0, cy=45.0)
RADIUS, AWAY, HEIGHT = 0.4, 2.0, 0.7
BOX = OrientedBox.between("ball", [-0.5, -0.5, -0.45], [0.5, 0.5, 0.5])
VIEWS = 24


def pose_at(angle: float, away: float = AWAY, height: float = HEIGHT) -> np.ndarray:
    """(4, 4) world_to_camera of a camera beside the ball that looks at it; z is up."""
    return look_at(np.array([away * np.cos(angle), away * np.sin(angle), height]))


def ball_scene(
    angles: Iterable[float] = tuple(2 * np.pi * np.arange(VIEWS) / VIEWS), folder: Path = Path()
) -> SfmScene:
    """Photos at these angles; each observes the points of the ball's side that it faces.

    Points that fewer than two photos observe are not there. The table is around the ball.
    """
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(900, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    table = np.column_stack([rng.uniform(-2, 2, (1500, 2)), np.full(1500, -RADIUS)])
    table = table[np.linalg.norm(table[:, :2], axis=1) > 0.55]
    points = np.concatenate([RADIUS * normals, table])
    images = []
    for number, angle in enumerate(angles):
        pose = pose_at(angle)
        image = PosedImage(
            name=f"{number:02d}.png",
            path=folder / f"{number:02d}.png",
            camera=CAMERA,
            world_to_camera=pose,
        )
        _, _, inside = project(points, CAMERA, pose)
        facing = ((image.centre - points[: len(normals)]) * normals).sum(axis=1) > 0.05
        inside[: len(normals)] &= facing
        inside[len(normals) :] &= ~_behind(image.centre, points[len(normals) :])
        images.append(replace(image, point_indices=np.flatnonzero(inside).astype(np.int64)))
    seen = np.bincount(np.concatenate([i.point_indices for i in images]), minlength=len(points))
    rows = np.cumsum(seen >= 2) - 1
    images = [
        replace(i, point_indices=rows[i.point_indices[seen[i.point_indices] >= 2]]) for i in images
    ]
    points = points[seen >= 2]
    colors = np.full((len(points), 3), 128, np.uint8)
    return SfmScene(images=tuple(images), points=points, colors=colors)


def _behind(eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) whether the ball is between the eye and each point (N, 3)."""
    ways = points - eye
    lengths = np.linalg.norm(ways, axis=1)
    along = -(ways @ eye) / lengths  # to the place nearest to the ball's centre
    nearest = np.sqrt(np.maximum(eye @ eye - along**2, 0))
    return (nearest < RADIUS) & (along < lengths)
