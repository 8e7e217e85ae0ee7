"""The scene that is measured: surfaces of flat Gaussians, seen from a ring of cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from roigs_engine.model.gaussians import SH_C0, Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.limits import TRAINING_LIMITS
from roigs_engine.training.edits import morton_order

CAMERAS = 8


class SyntheticPhotos:
    """Cameras of one size around the scene, and one photo of random pixels for all of them.

    Attributes:
        size: width and height in pixels.
        poses: (CAMERAS, 4, 4) world_to_camera.
        intrinsics: (1, 3, 3).
        photo: (H, W, 3) uint8.
    """

    def __init__(self, size: tuple[int, int], device: torch.device | None = None) -> None:
        width, height = self.size = size
        camera = ring_camera(width, height)
        matrix = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        self.intrinsics = torch.tensor([matrix], device=device)
        self.poses = ring_cameras().to(device)
        generator = torch.Generator().manual_seed(0)
        shape = (height, width, 3)
        photo = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)
        self.photo = photo.to(device)

    def render(self, gaussians: Gaussians, pose: Tensor, **options: Any) -> RenderOutput:
        """Render the Gaussians as in training; options as of `rasterize`."""
        g = gaussians
        return rasterize(
            *(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh),
            pose[None],
            self.intrinsics,
            *self.size,
            raw=True,
            limits=TRAINING_LIMITS,
            **options,
        )


def synthetic_gaussians(count: int, seed: int = 0) -> Gaussians:
    """Flat Gaussians on surfaces: 40 % ground, 40 % balls on it, 20 % a shell far away."""
    rng = np.random.default_rng(seed)
    kind = np.sort(rng.choice(3, count, p=[0.4, 0.4, 0.2]))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = rng.integers(0, 6, count)
    turns = np.arange(6) * np.pi / 3
    centres = np.stack([1.3 * np.cos(turns), 1.3 * np.sin(turns), np.full(6, 0.5)], axis=1)
    means = np.where((kind == 1)[:, None], centres[ball] + 0.5 * directions, 13.0 * directions)
    radius, angle = 4.5 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    ground = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.05 * np.sin(radius)], 1)
    means = np.where((kind == 0)[:, None], ground, means)
    area = np.array([64.0, 6 * 3.1, 2100.0])[kind] / np.bincount(kind, minlength=3)[kind]
    scales = 0.8 * np.sqrt(area)[:, None] * np.exp(rng.normal(size=(count, 3)) * 0.4)
    scales[:, 2] *= 0.2
    sh = rng.normal(size=(count, 16, 3)) * 0.04
    sh[:, 0] = (rng.uniform(0.05, 0.95, (count, 3)) - 0.5) / SH_C0
    opacities = np.where(rng.uniform(size=count) < 0.45, rng.beta(1.2, 5, count), 0.8)
    arrays = {
        "means": means,
        "quats": rng.normal(size=(count, 4)),
        "log_scales": np.log(scales),
        "logit_opacities": np.log(opacities / (1 - opacities)),
        "sh": sh,
    }
    model = Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})
    return model.rows(morton_order(model.means))


def trainable(count: int, device: torch.device | None = None) -> Gaussians:
    """`synthetic_gaussians` on a device, as autograd leaves."""
    model = synthetic_gaussians(count).to(device or torch.device("cpu"))
    tensors = model.tensors()
    return model.with_tensors({name: t.requires_grad_() for name, t in tensors.items()})


def ring_camera(width: int, height: int) -> Camera:
    """The camera of every photo."""
    focal = 0.87 * width
    return Camera(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def ring_cameras() -> Tensor:
    """(CAMERAS, 4, 4) world_to_camera of cameras around the middle that look at it."""
    poses = []
    for angle in np.arange(CAMERAS) * 2 * np.pi / CAMERAS:
        eye = np.array([4.4 * np.cos(angle), 4.4 * np.sin(angle), 1.6])
        forward = np.array([0, 0, 0.5]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
        poses.append(pose)
    return torch.from_numpy(np.array(poses)).float()
