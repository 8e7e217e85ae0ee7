"""Depth maps and photos of a coloured ball, exact to a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.surface.depth import DepthMap
from tests.poses import look_at

RADIUS = 0.5
BOX = OrientedBox.between("ball", [-0.6, -0.62, -0.64], [0.6, 0.62, 0.64])
CAMERA = Camera(width=96, height=80, fx=150.0, fy=150.0, cx=48.0, cy=40.0)
DISCS, SIZE = 3000, 0.02  # size: standard deviation, a pixel and a half
BEHIND = 8.0  # depth of what is behind the ball


def colour_at(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) 0 to 255: smooth over the ball."""
    return 128 + 180 * points


def images(count: int = 24) -> list[PosedImage]:
    """Photos from all around (a Fibonacci sphere)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    centres = 2.2 * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    return [
        PosedImage(
            name=f"{n:02d}.png",
            path=Path(),
            camera=CAMERA,
            world_to_camera=look_at(centre, np.zeros(3)),
        )
        for n, centre in enumerate(centres)
    ]


def rays_hit(image: PosedImage) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H, W) depth of the ball, NaN beside it; (H, W, 3) where rays hit it, in the world."""
    camera = image.camera
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    middle = image.world_to_camera[:3, 3]
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - RADIUS**2
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b**2 - a * c)) / a
    return depth, (rays * depth[..., None] - middle) @ image.world_to_camera[:3, :3]


def depth_map(image: PosedImage) -> DepthMap:
    """The depth map of a perfect model."""
    depth, _ = rays_hit(image)
    depth = np.where(np.isnan(depth), BEHIND, depth).astype(np.float32)
    return DepthMap(
        image=image, x=0, y=0, camera=image.camera, depth=depth, weight=np.ones_like(depth)
    )


def photo(image: PosedImage, gain: float = 1.0) -> NDArray[np.uint8]:
    """The photo, on black."""
    depth, places = rays_hit(image)
    colours = np.where(np.isnan(depth)[..., None], 0, colour_at(places) * gain)
    return np.clip(colours, 0, 255).round().astype(np.uint8)


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
