"""A ball that is too small, or plain: moved to where its photos agree, or left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import PosedImage
from roigs_engine.surface.fusion import fuse
from roigs_engine.surface.mesh import Mesh, mesh_of
from roigs_engine.surface.photo_fit import fitted
from tests.engine.surface.ball import BOX, CAMERA, RADIUS, depth_map, images, photo, rays_hit

pytest.importorskip("skimage")
PIXEL = (2.2 - RADIUS) / CAMERA.fx
MAPS = [depth_map(image) for image in images(40)]


@pytest.fixture(scope="module")
def small() -> Mesh:
    """The ball, a pixel too small."""
    ball = mesh_of(fuse(MAPS, BOX, 0.04), BOX, MAPS)
    return replace(ball, vertices=ball.vertices * (1 - PIXEL / RADIUS))


def spotted(image: PosedImage) -> NDArray[np.uint8]:
    depth, places = rays_hit(image)
    waves = np.sin(places @ np.random.default_rng(3).normal(0, 40, (3, 6))).sum(axis=-1)
    return (
        np.where(np.isnan(depth), 0, 128 + 25 * waves)
        .clip(0, 255)
        .astype(np.uint8)[..., None]
        .repeat(3, axis=2)
    )


def test_a_mesh_inside_its_object_is_moved_out(small: Mesh) -> None:
    found = fitted(small, MAPS, BOX, spotted)
    off = np.linalg.norm(found.vertices, axis=1) - RADIUS
    assert abs(np.median(off)) < 0.15 * PIXEL
    assert np.percentile(np.abs(off), 95) < 0.4 * PIXEL
    assert (found.faces == small.faces).all()


def test_a_mesh_of_a_plain_object_stays(small: Mesh) -> None:
    found = fitted(small, MAPS, BOX, photo)
    assert np.abs(found.vertices - small.vertices).max() < 0.3 * PIXEL
    none = fitted(small, MAPS[:1], BOX, spotted)
    np.testing.assert_array_equal(none.vertices, small.vertices)


def test_nothing_is_moved_out_of_the_box(small: Mesh) -> None:
    top = float(small.vertices[:, 2].max())
    box = OrientedBox.between("box", [-9, -9, -9], [9, 9, top])
    found = fitted(small, MAPS, box, spotted)
    assert found.vertices[:, 2].max() <= top
    assert np.linalg.norm(found.vertices, axis=1).max() > RADIUS - 0.4 * PIXEL


def test_rims_are_moved_as_their_neighbourhood_is(small: Mesh) -> None:
    """The normals of single faces that stick out of a rim are noise."""
    rng = np.random.default_rng(1)
    flaps = rng.choice(len(small.faces), 200, replace=False)
    corners = small.vertices[small.faces[flaps]]
    noise = rng.normal(0, 0.3 * PIXEL, corners.shape)
    loose = np.arange(corners.size // 3).reshape(-1, 3) + len(small.vertices)
    ragged = Mesh(
        vertices=np.concatenate([small.vertices, (corners + noise).reshape(-1, 3)]),
        faces=np.concatenate([small.faces, loose]),
        filled=np.zeros(len(small.faces) + len(loose), bool),
    )
    moves = fitted(ragged, MAPS, BOX, spotted).vertices - ragged.vertices
    whole = moves[small.faces[flaps]].reshape(-1, 3)
    assert (
        np.percentile(np.linalg.norm(moves[len(small.vertices) :] - whole, axis=1), 95)
        < 0.15 * PIXEL
    )
