"""Panoramas against pinhole pictures from the same point."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.nn.functional import grid_sample

from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.instances import NOTHING, Instance, Layer, render_instances
from roigs_engine.rasterize.panorama import render_panorama
from tests.engine.clouds import affine, cloud, on_black, placed

HEIGHT = 512
DENSITY = HEIGHT / np.pi
LENS = Camera(width=160, height=120, fx=DENSITY, fy=DENSITY, cx=80.0, cy=60.0)


def equirectangular() -> torch.Tensor:
    """(H, 2 H, 3) rays in OpenCV axes: forward in the middle, up on top."""
    longitude = (np.arange(2 * HEIGHT) + 0.5) / HEIGHT * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(HEIGHT)[:, None] + 0.5) / HEIGHT * np.pi
    rays = np.stack(
        np.broadcast_arrays(
            np.cos(latitude) * np.sin(longitude),
            -np.sin(latitude),
            np.cos(latitude) * np.cos(longitude),
        ),
        axis=-1,
    )
    return torch.from_numpy(rays.astype(np.float32))


def pinhole_rays(turn: np.ndarray) -> torch.Tensor:
    """(H, W, 3) unit rays of `LENS`, turned, in the panorama's frame."""
    y, x = np.mgrid[: LENS.height, : LENS.width] + 0.5
    rays = np.stack([(x - LENS.cx) / LENS.fx, (y - LENS.cy) / LENS.fy, np.ones_like(x)], axis=-1)
    rays = rays @ turn
    return torch.from_numpy((rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype("f4"))


def looked_up(picture: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """(H, W, C) of an equirectangular picture."""
    x, y, z = rays.unbind(-1)
    places = torch.stack([torch.atan2(x, z) / np.pi, torch.asin(y) / (np.pi / 2)], dim=-1)
    channels = picture.permute(2, 0, 1)[None]
    found = grid_sample(channels, places[None], align_corners=False, padding_mode="border")
    return found[0].permute(1, 2, 0)


@pytest.fixture(scope="module")
def around_us() -> tuple[list[Instance], Layer]:
    """Gaussians on all sides, and their panorama."""
    around = np.random.default_rng(1).normal(size=(900, 3)).astype(np.float32)
    around *= 3 / np.linalg.norm(around, axis=1, keepdims=True)
    sizes = np.random.default_rng(2).uniform(np.log(0.02), np.log(0.2), (900, 3))
    models = [placed(cloud(900, means=around, log_scales=sizes))]
    return models, render_panorama(models, equirectangular(), DENSITY, np.eye(4))


@pytest.mark.parametrize("angles", [(0, 0), (45, 35), (150, -30), (-80, 60)])
def test_pinhole_views_are_found_in_it(
    around_us: tuple[list[Instance], Layer], angles: tuple[float, float]
) -> None:
    """Seams of the cube included."""
    models, panorama = around_us
    turn = Rotation.from_euler("yx", angles, degrees=True).as_matrix()
    layer = render_instances(models, LENS, affine(turn))
    rays = pinhole_rays(turn)
    seen = looked_up(on_black(panorama), rays)
    error = (seen - on_black(layer)).square().mean()
    assert on_black(layer).std() > 0.1
    assert -10 * torch.log10(error) > 38
    found = looked_up(panorama.alpha[..., None], rays)[..., 0]
    assert -10 * torch.log10((found - layer.alpha).square().mean()) > 38


def test_rays_that_see_nothing_and_depths() -> None:
    """A wall before the camera: depths are distances, and a ray of 0 sees nothing."""
    flat = {"means": np.array([[0.0, 0, 4]]), "quats": np.array([[1.0, 0, 0, 0]])}
    wall = cloud(1, log_scales=np.log([[1.5, 1.5, 0.001]]), logit_opacities=np.array([9.0]), **flat)
    rays = torch.tensor([[[0.0, 0, 2], [0.5, 0, 2], [0, 0, 0], [0, 0, -1]]])
    layer = render_panorama([placed(wall)], rays, 100.0, np.eye(4))
    assert (layer.alpha[0] > 0.7).tolist() == [True, True, False, False]
    assert layer.depth[0, :2].tolist() == pytest.approx([4, 4 * 1.0625**0.5], rel=0.01)
    assert layer.depth[0, 2:].tolist() == [NOTHING, NOTHING]
