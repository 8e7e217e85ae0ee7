"""Random clouds of Gaussians, moved, and drawn by one camera."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.instances import Instance, Layer

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)

POSE = np.eye(4)
POSE[2, 3] = 4.0  # looks at the origin


def cloud(count: int = 60, seed: int = 0, **changed: np.ndarray) -> Gaussians:
    random = np.random.default_rng(seed)
    arrays = {
        "means": random.normal(scale=0.6, size=(count, 3)),
        "quats": random.normal(size=(count, 4)),
        "log_scales": random.uniform(np.log(0.02), np.log(0.3), (count, 3)),
        "logit_opacities": random.uniform(-2, 4, count),
        "sh": random.normal(scale=0.12, size=(count, 16, 3)),
    } | changed
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def placed(gaussians: Gaussians, matrix: np.ndarray | None = None) -> Instance:
    place = np.eye(4) if matrix is None else matrix
    return Instance(gaussians=gaussians, frame=LocalFrame.world(), matrix=place)


def on_black(layer: Layer) -> torch.Tensor:
    return layer.image * layer.alpha[..., None]


def affine(linear: np.ndarray, offset: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, offset
    return matrix


TURN = Rotation.from_euler("xyz", [40, 130, -70], degrees=True).as_matrix()
