"""A ball on a table: cut off by masks, and closed flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roigs_engine.surface.depth import DepthMap
from roigs_engine.surface.fusion import fuse
from roigs_engine.surface.mesh import mesh_of
from roigs_engine.surface.objects import cut_off, support_of
from tests.engine.surface.ball import BOX, RADIUS, depth_map, images

pytest.importorskip("skimage")
VOXEL = 0.02
TABLE = -0.45  # height: the ball is sunk a little into it


def on_table(masked: bool = True) -> list[DepthMap]:
    """Photos from above of the ball and a table."""
    found = []
    for image in images(60):
        if image.centre[2] < TABLE + 0.5:
            continue
        ball, camera = depth_map(image), image.camera
        x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
        rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
        down = rays @ image.world_to_camera[:3, 2]
        with np.errstate(divide="ignore"):
            table = np.where(down < 0, (TABLE - image.centre[2]) / down, np.inf)
        own = ball.depth < np.minimum(table, 7.0)
        depth = np.minimum(ball.depth, table).astype(np.float32)
        weight = np.where(own | (not masked), 1, -1).astype(np.float32)
        found.append(replace(ball, depth=depth, weight=weight))
    return found


def test_the_support_is_found_where_it_is() -> None:
    support = support_of(on_table(), BOX, VOXEL)
    assert support is not None
    assert support.normal == pytest.approx([0, 0, 1], abs=0.01)
    assert support.height == pytest.approx(TABLE, abs=0.1 * VOXEL)


def test_masks_cut_an_object_off_its_table() -> None:
    maps = on_table()
    support = support_of(maps, BOX, VOXEL)
    assert support is not None
    field = cut_off(fuse(maps, BOX, VOXEL), support)
    with_hole, closed = mesh_of(field, BOX, maps), mesh_of(field, BOX, maps, closed=True)
    assert closed.is_closed() and not with_hole.is_closed()
    for mesh in (with_hole, closed):
        assert np.linalg.norm(mesh.vertices, axis=1).max() < RADIUS + 1.5 * VOXEL
        assert len(np.unique(mesh.parts())) == 1
    assert np.abs(closed.vertices[:, 2].min() - TABLE) < 2 * VOXEL
    middle = closed.vertices[closed.faces].mean(axis=1)
    bottom = (np.linalg.norm(middle[:, :2], axis=1) < 0.1) & (middle[:, 2] < 0)
    assert bottom.any() and closed.filled[bottom].all()
    assert np.ptp(middle[bottom, 2]) < 0.1 * VOXEL  # flat
    sides = middle[:, 2] > TABLE + 9 * VOXEL  # two photos show them
    assert not closed.filled[sides].any()


def test_without_masks_the_table_is_a_part_of_the_mesh() -> None:
    maps = on_table(masked=False)
    mesh = mesh_of(fuse(maps, BOX, VOXEL), BOX, maps)
    assert np.abs(mesh.vertices[:, :2]).max() > RADIUS + 2 * VOXEL


def test_without_a_plane_below_there_is_no_support() -> None:
    around = [replace(m, weight=np.where(m.depth < 7, 1, -1)) for m in map(depth_map, images())]
    assert support_of(around, BOX, VOXEL) is None
