"""Depth from photos: a plane and a ball whose depth is known, begun with a depth that is off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage, SfmScene
from roigs_engine.surface.depth import DOUBTFUL, MOST, depth_maps, neighbours
from roigs_engine.surface.matching import SWEEPS, Shot, matched
from tests.poses import look_at

from .ball import BOX, CAMERA, RADIUS, images, rays_hit

PLACES = ((0.0, -2.2, 0.2), (0.8, -2.0, 0.1), (-0.8, -2.0, 0.4), (0.2, -2.0, 1.0))
Floats = NDArray[np.float64]
Hit = Callable[[PosedImage], tuple[Floats, Floats]]


def pattern(points: Floats) -> Floats:
    """(..., 3) -> grey in 0 to 1, with detail of several sizes."""
    rng = np.random.default_rng(5)
    waves = rng.normal(size=(40, 3)) * rng.uniform(8, 40, (40, 1))
    phases = np.sin(points @ waves.T + rng.uniform(0, 6, 40))
    return np.clip(0.5 + phases.sum(axis=-1) / 20, 0, 1)


def photos() -> list[PosedImage]:
    poses = [look_at(np.array(place), np.zeros(3)) for place in PLACES]
    return [
        PosedImage(name=f"{n}.png", path=Path(f"{n}.png"), camera=CAMERA, world_to_camera=pose)
        for n, pose in enumerate(poses)
    ]


def plane_hit(image: PosedImage) -> tuple[Floats, Floats]:
    """As `rays_hit`, of the plane y = 0.1 x."""
    camera = image.camera
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    rays = rays @ image.world_to_camera[:3, :3]
    normal = np.array([-0.1, 1, 0])
    depth = -(image.centre @ normal) / (rays @ normal)
    return depth, image.centre + depth[..., None] * rays


def stack(image: PosedImage, hit: Hit, off: float) -> tuple[list[Shot], torch.Tensor]:
    """The photo's levels, with a depth that is off by so much and rough; and the true depth."""
    depth, points = hit(image)
    rough = depth * (1 + off + 0.003 * np.random.default_rng(1).normal(size=depth.shape))
    shot = Shot(
        camera=image.camera,
        pose=torch.from_numpy(image.world_to_camera),
        grey=torch.from_numpy(np.nan_to_num(pattern(points))).float(),
        depth=torch.from_numpy(np.nan_to_num(rough)).float(),
    )
    shots = [shot]
    while len(shots) < len(SWEEPS):
        shots.append(shots[-1].halved())
    return shots, torch.from_numpy(depth)


@pytest.mark.parametrize("hit", [plane_hit, rays_hit])
@pytest.mark.parametrize("off", [0.0, 0.02, -0.02])
def test_a_depth_that_is_off_is_made_exact(hit: Hit, off: float) -> None:
    stacks = [stack(image, hit, off) for image in photos()]
    depth, likeness = matched(stacks[0][0], [shots for shots, _ in stacks[1:]])
    true = stacks[0][1]
    middle = torch.zeros_like(likeness, dtype=torch.bool)
    middle[20:-20, 25:-25] = True  # elsewhere, photos do not overlap
    found = (likeness > 0) & middle
    assert found.sum() > 0.8 * middle.sum()
    error = ((depth - true).abs() / true)[found]
    assert error.median() < 0.001
    assert error.quantile(0.9) < 0.005


def test_without_contrast_or_other_photos_the_depth_stays() -> None:
    shots, _ = stack(photos()[0], plane_hit, 0.0)
    flat = [replace(shot, grey=torch.full_like(shot.grey, 0.3)) for shot in shots]
    for others in ([], [flat]):
        depth, likeness = matched(flat, others)
        assert not likeness.any()
        assert ((depth - shots[0].depth).abs() < 0.02 * depth).all()


def test_what_another_photo_cannot_see_is_not_compared_with_it() -> None:
    first, second = (stack(image, plane_hit, 0.0)[0] for image in photos()[:2])
    hidden = [replace(shot, depth=0.5 * shot.depth) for shot in second]
    assert matched(first, [second])[1].any()
    assert not matched(first, [hidden])[1].any()


def test_the_same_bytes_each_time() -> None:
    stacks = [stack(image, rays_hit, 0.01)[0] for image in photos()]
    once, again = (matched(stacks[0], stacks[1:]) for _ in range(2))
    assert torch.equal(once[0], again[0]) and torch.equal(once[1], again[1])


def test_neighbours_look_from_the_side_and_are_as_fine() -> None:
    near = photos()
    coarse = replace(near[1], camera=CAMERA.resized(CAMERA.width // 4, CAMERA.height // 4))
    behind = replace(near[1], world_to_camera=look_at(np.array([0, 2.2, 0]), np.zeros(3)))
    assert neighbours(0, [near[0], coarse, near[2], behind, near[0]], BOX) == [2]
    assert len(neighbours(0, images(60), BOX)) == MOST


def ball_scene() -> tuple[Gaussians, SfmScene]:
    """Opaque small Gaussians on the ball, and photos of it."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6000, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    gaussians = Gaussians.from_points(points, np.full((6000, 3), 128, np.uint8))
    opaque = {"logit_opacities": torch.full((6000,), 4.0)}
    none = np.zeros((0, 3))
    scene = SfmScene(images=tuple(photos()), points=none, colors=none.astype(np.uint8))
    return gaussians.with_tensors({**gaussians.tensors(), **opaque}), scene


def load(image: PosedImage) -> NDArray[np.uint8]:
    grey = np.nan_to_num(pattern(rays_hit(image)[1]))
    return np.repeat((255 * grey).astype(np.uint8)[..., None], 3, axis=2)


def test_depth_maps_are_exact_where_they_are_certain() -> None:
    gaussians, scene = ball_scene()
    for depth_map in depth_maps(gaussians, scene, BOX, ["0.png", "1.png", "2.png"], load=load):
        true = rays_hit(depth_map.image)[0]
        height, width = depth_map.depth.shape
        true = true[depth_map.y :, depth_map.x :][:height, :width]
        certain = (depth_map.weight > DOUBTFUL) & np.isfinite(true)
        assert certain.sum() > 0.4 * np.isfinite(true).sum()
        assert np.median(np.abs(depth_map.depth - true)[certain]) < 0.003


@pytest.mark.parametrize("seen", [3, 9])
def test_a_photo_that_shows_a_sliver_of_the_box_is_left_out_or_used(seen: int) -> None:
    gaussians, scene = ball_scene()
    first = scene.images[0]
    left = BOX.silhouette_polygon(CAMERA, first.world_to_camera)
    assert left is not None
    camera = replace(CAMERA, cx=CAMERA.cx - left[:, 0].max() + seen - 2)
    edge = replace(first, name="edge.png", camera=camera)
    scene = replace(scene, images=(*scene.images, edge))
    names = {
        each.image.name
        for each in depth_maps(gaussians, scene, BOX, ["0.png", "edge.png"], load=load)
    }
    assert ("edge.png" in names) == (seen == 9)


def test_depth_maps_stop_on_request_also_while_photos_are_compared() -> None:
    gaussians, scene = ball_scene()
    asked = iter(range(100))
    context = Context(should_stop=lambda: next(asked) > 3)
    maps = depth_maps(gaussians, scene, BOX, ["0.png", "1.png", "2.png"], context, load=load)
    next(maps)
    with pytest.raises(Stopped):
        next(maps)
