"""Cells of a scene: balanced, the same in any frame and unit, with the photos that show them."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.selection.cells import (
    Views,
    ground_cells,
    photos_of_cells,
    visible_owners,
)
from tests.poses import look_at

CAMERA = Camera(width=64, height=48, fx=40.0, fy=40.0, cx=32.0, cy=24.0)


def street(length: float = 40.0, photos: int = 60) -> SfmScene:
    """A street along x: cameras on one side look at the houses on the other."""
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 4, 0], [length, 5, 3], (1500, 3))
    images = []
    for k, x in enumerate(np.linspace(0, length, photos)):
        eye = np.array([x, 0, 1.5 + 0.2 * (k % 3)])
        pose = look_at(eye, eye + np.array([0.3 * (k % 3 - 1), 4, 0.1]))
        local = points @ pose[:3, :3].T + pose[:3, 3]
        seen = np.flatnonzero(
            (local[:, 2] > 0)
            & (np.abs(local[:, 0]) < 0.8 * local[:, 2])
            & (np.abs(local[:, 1]) < 0.6 * local[:, 2])
        )
        name = f"{k:03d}.jpg"
        images.append(
            PosedImage(
                name=name,
                path=Path(name),
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=seen.astype(np.int64),
            )
        )
    return SfmScene(
        images=tuple(images), points=points, colors=np.zeros((len(points), 3), np.uint8)
    )


SCENE = street()


def turned(scene: SfmScene, rotation: np.ndarray, scale: float) -> SfmScene:
    """The scene in another frame and unit."""
    images = []
    for image in scene.images:
        pose = image.world_to_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ rotation.T
        pose[:3, 3] *= scale
        images.append(replace(image, world_to_camera=pose))
    return replace(scene, images=tuple(images), points=scene.points @ rotation.T * scale)


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_cells_are_balanced_and_along_the_street(count: int) -> None:
    points, cameras = ground_cells(Views.of(SCENE), count)
    assert set(points) == set(range(count)) == set(cameras)
    for cells in (np.bincount(points), np.bincount(cameras)):
        assert cells.min() > 0.5 * cells.max()
    ends = [SCENE.points[points == cell, 0] for cell in range(count)]
    spans = sorted((end.min(), end.max()) for end in ends)
    assert all(a[1] <= b[0] + 0.5 for a, b in pairwise(spans))


@pytest.mark.parametrize("scale", [1e-3, 1000.0])
def test_the_frame_and_the_units_do_not_matter(scale: float) -> None:
    usual = ground_cells(Views.of(SCENE), 4)
    rotation = Rotation.from_euler("xyz", [100, 20, 200], degrees=True).as_matrix()
    other = ground_cells(Views.of(turned(SCENE, rotation, scale)), 4)
    for one, two in zip(usual, other, strict=True):
        pairs = {(int(a), int(b)) for a, b in zip(one, two, strict=True)}
        assert len(pairs) == 4  # the same cells, perhaps in another order


def test_photos_train_the_cells_that_they_show() -> None:
    views = Views.of(SCENE)
    points, cameras = ground_cells(views, 4)
    photos = photos_of_cells(views, points, cameras, 4)
    assert photos.any(axis=1).all()  # each photo is used
    each = photos.sum(axis=0)
    assert each.max() < 0.6 * len(SCENE.images)  # and no cell has all of them
    assert 1 < photos.sum(axis=1).mean() < 2.2  # cells overlap


def test_a_point_that_its_cell_hardly_sees_changes_its_cell() -> None:
    views = Views.of(SCENE)
    points, cameras = ground_cells(views, 2)
    photos = photos_of_cells(views, points, cameras, 2)
    assert (visible_owners(views, points, photos) == points).mean() > 0.95
    # Without its photos, a cell owns nothing that the other's photos see.
    photos[:, 0] = False
    owner = visible_owners(views, points, photos)
    assert (owner[views.times(photos[:, 1]) > 0] == 1).all()


def test_a_model_without_tracks_is_projected() -> None:
    bare = tuple(replace(i, point_indices=np.zeros(0, np.int64)) for i in SCENE.images)
    views = Views.of(replace(SCENE, images=bare, has_tracks=False))
    tracks = Views.of(SCENE)
    found, usual = (np.asarray(v.seen.sum(axis=1)).ravel() for v in (views, tracks))
    assert (found > 0.5 * usual).all()


def test_more_cells_than_points() -> None:
    few = replace(SCENE, points=SCENE.points[:3], images=SCENE.images[:2])
    images = tuple(replace(i, point_indices=np.arange(3)) for i in few.images)
    points, cameras = ground_cells(Views.of(replace(few, images=images)), 16)
    assert len(points) == 3 and len(cameras) == 2 and points.max() < 16


def test_cameras_at_one_position() -> None:
    centre = np.array([20.0, 0, 1.5])
    images = []
    for image in SCENE.images:
        pose = image.world_to_camera.copy()
        pose[:3, 3] = -pose[:3, :3] @ centre
        images.append(replace(image, world_to_camera=pose))
    scene = LocalFrame.of_scene(SCENE).scene(replace(SCENE, images=tuple(images)))
    points, _ = ground_cells(Views.of(scene), 4)
    assert set(points) == {0, 1, 2, 3}


def test_many_points_take_little_memory() -> None:
    rng = np.random.default_rng(0)
    many = replace(SCENE, points=rng.uniform(0, 40, (200_000, 3)))
    tracemalloc.start()
    ground_cells(Views.of(many), 4)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6  # 500 bytes a point
