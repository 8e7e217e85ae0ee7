"""Photos on a ring around an object, and opaque balls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage
from roigs_engine.training.floaters import largest_shares, photo_views
from tests.engine.synthetic_scene import CAMERA
from tests.poses import look_at

DISTANCE = 4.0
OBJECT = np.random.default_rng(0).normal(scale=0.1, size=(50, 3))  # the scene's points
NO_POINTS = np.zeros((0, 3))


def shown(model: Gaussians, images: list[PosedImage]) -> torch.Tensor:
    """The largest share of a photo that each Gaussian fills."""
    return largest_shares(model, photo_views(images))


def photo(name: str, eye: np.ndarray, target: np.ndarray | None = None) -> PosedImage:
    """A photo from a place to another, by default the origin."""
    return PosedImage(
        name=name,
        path=Path(),
        camera=CAMERA,
        world_to_camera=look_at(eye, np.zeros(3) if target is None else target),
        point_indices=np.zeros(0, dtype=np.int64),
    )


def ring(count: int, whole: int | None = None) -> list[PosedImage]:
    """`count` photos of a ring of `whole` around the origin."""
    return [photo(f"{k}.png", at(k / (whole or count))) for k in range(count)]


def at(share: float, distance: float = DISTANCE) -> np.ndarray:
    """A place on the ring."""
    angle = 2 * np.pi * share
    return distance * np.array([np.cos(angle), np.sin(angle), 0.0])


def gaussians(*sized: tuple[np.ndarray, float]) -> Gaussians:
    """Opaque balls, each (place, standard deviation)."""
    count = len(sized)
    arrays = {
        "means": np.array([place for place, _ in sized]).reshape(count, 3),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "log_scales": np.log([size for _, size in sized])[:, None].repeat(3, axis=1),
        "logit_opacities": np.full(count, 3.0),
        "sh": np.zeros((count, 16, 3)),
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def sees(image: PosedImage, point: np.ndarray) -> bool:
    """Whether a point is inside the photo's frame."""
    x, y, z = image.world_to_camera[:3, :3] @ point + image.world_to_camera[:3, 3]
    u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
    return bool(z > 0 and 0 <= u < CAMERA.width and 0 <= v < CAMERA.height)
