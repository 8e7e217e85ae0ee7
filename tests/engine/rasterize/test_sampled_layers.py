"""Layers averaged over samples of the lens and of time, and the surfaces that hide Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.model.scene import Camera, Float64
from roigs_engine.rasterize.instances import (
    NOTHING,
    Layer,
    mean_layer,
    render_instances,
    surface_depth,
)
from roigs_engine.rasterize.light import to_linear
from tests.engine.clouds import CAMERA, POSE, TURN, affine, cloud, placed

LENS = Camera(width=97, height=70, fx=80.0, fy=90.0, cx=41.5, cy=33.0)


def quad(corners: Float64) -> Tensor:
    """Two triangles of four corners (4, 3)."""
    return torch.tensor(corners[[[0, 1, 2], [0, 2, 3]]], dtype=torch.float32)


def ray_depth(camera: Camera, normal: Float64, offset: float) -> Float64:
    """(H, W) depth of the plane normal . p = offset at each pixel's centre, camera's frame."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return np.asarray(offset / (normal[0] * x + normal[1] * y[:, None] + normal[2]))


@pytest.mark.parametrize("turned", [False, True])
def test_a_wall_has_the_depth_of_its_plane(turned: bool) -> None:
    """It reaches over the picture's edges; without gaps along the diagonal, from either side."""
    corners = np.array([[-9.0, -9, 6], [9, -9, 8], [9, 9, 9], [-9, 9, 7]])
    pose = affine(TURN, (0.3, -2.0, 5.0))
    world = corners @ TURN - pose[:3, 3] @ TURN
    triangles = quad(world[::-1].copy() if turned else world)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    expected = ray_depth(LENS, normal, float(normal @ corners[0]))
    found = surface_depth(triangles, LENS, pose).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_floor_that_passes_under_the_camera_is_cut_off_before_it() -> None:
    corners = np.array([[-50.0, 1, -3], [50, 1, -3], [50, 1, 40], [-50, 1, 40]])
    found = surface_depth(quad(corners), LENS, np.eye(4)).numpy()
    with np.errstate(divide="ignore"):
        expected = ray_depth(LENS, np.array([0.0, 1, 0]), 1.0)
    floor = (expected > 0) & (expected < 40)
    np.testing.assert_allclose(found[floor], expected[floor], rtol=1e-5)
    assert (found[~floor] == np.float32(NOTHING)).all() and floor.mean() > 0.3


def test_the_nearest_surface_counts_and_a_pixel_is_covered_by_its_centre() -> None:
    small = np.array([[-0.49, -0.49, 2], [0.49, -0.49, 2], [0.49, 0.49, 2], [-0.49, 0.49, 2]])
    both = torch.cat([quad(small * 2 + [0, 0, 5]), quad(small)])
    found = surface_depth(both, LENS, np.eye(4)).numpy()
    columns = (np.arange(97) + 0.5 - 41.5) / 80 * 2
    rows = (np.arange(70) + 0.5 - 33) / 90 * 2
    inside = (abs(columns) < 0.49) & (abs(rows[:, None]) < 0.49)
    assert (found[inside] == 2).all() and (found[~inside] != 2).all()
    assert surface_depth(both[:0], LENS, np.eye(4)).min() == NOTHING


def plain(colour: float, alpha: float, depth: float) -> Layer:
    """A layer of one pixel."""
    one = torch.ones(1, 1)
    return Layer(image=colour * torch.ones(1, 1, 3), alpha=alpha * one, depth=depth * one)


def test_the_mean_is_that_of_the_light() -> None:
    none = torch.full((1, 1), NOTHING)
    layers = [(plain(0.9, 0.5, 2.0), none), (plain(0.2, 1.0, 3.0), none)]
    found = mean_layer(layers)
    light = (0.5 * to_linear(torch.tensor(0.9)) + to_linear(torch.tensor(0.2))) / 1.5
    torch.testing.assert_close(to_linear(found.image), light.expand(1, 1, 3))
    assert found.alpha.item() == 0.75 and found.depth.item() == pytest.approx(-4 / 1.5)


def test_a_surface_hides_what_is_behind_it_in_its_sample_alone() -> None:
    wall = torch.full((1, 1), 2.5)
    found = mean_layer([(plain(0.9, 1.0, 2.0), wall), (plain(0.2, 1.0, 3.0), wall)])
    torch.testing.assert_close(found.image, torch.full((1, 1, 3), 0.9))
    assert found.alpha.item() == 0.5 and found.depth.item() == -2
    none = mean_layer([(plain(0.9, 1.0, 3.0), wall)])
    assert none.alpha.item() == 0 and none.depth.item() == np.float32(-NOTHING)


def test_one_sample_is_the_layer() -> None:
    layer = render_instances([placed(cloud())], CAMERA, POSE)
    nothing = surface_depth(torch.zeros(0, 3, 3), CAMERA, POSE)
    found = mean_layer([(layer, nothing)])
    shown = layer.alpha > 0.01
    torch.testing.assert_close(found.image[shown], layer.image[shown], atol=1e-4, rtol=0)
    torch.testing.assert_close(found.alpha, layer.alpha)
    hidden = mean_layer([(layer, torch.zeros_like(layer.depth))])
    assert not hidden.alpha.any() and hidden.image.isfinite().all()
    shorter = replace(layer, depth=layer.depth * 0)
    torch.testing.assert_close(mean_layer([(shorter, nothing)]).alpha, layer.alpha)


def test_what_is_partly_in_front_covers_another_share_of_the_pixel() -> None:
    """Three of four samples are hidden by a surface: opaque Gaussians fill the rest, below it."""
    wall, none = torch.full((1, 1), 2.0), torch.full((1, 1), NOTHING)
    samples = [(plain(0.5, 1.0, 3.0), wall)] * 3 + [(plain(0.5, 1.0, 3.0), none)]
    above, under = mean_layer(samples), mean_layer(samples, below=True)
    assert above.alpha.item() == 0.25 and above.depth.item() == -3
    assert under.alpha.item() == 1 and under.depth.item() > NOTHING
    further = [(plain(0.5, 1.0, 1.0), wall)] * 3
    assert mean_layer(further, below=True).depth.item() == -1
