"""A captured object from numbers alone: its light, its support, its picture."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry import irradiance, little_picture, support

AXES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)


def box(low, high) -> np.ndarray:
    """(12, 3, 3) triangles of a box, outwards."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    quads = []
    for axis in range(3):
        for side, order in ((0.0, (0, 1, 3, 2)), (1.0, (0, 2, 3, 1))):
            square = np.insert([(0, 0), (1, 0), (0, 1), (1, 1)], axis, side, axis=1)
            ring = square[list(order if axis != 1 else order[::-1])]
            quads += [ring[[0, 2, 1]], ring[[0, 3, 2]]]
    triangles = low + np.array(quads) * (high - low)
    crosses = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inwards = (crosses * (triangles.mean(axis=1) - (low + high) / 2)).sum(axis=1) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return triangles.astype(np.float32)


def test_an_even_light_is_the_same_for_all_normals() -> None:
    light = np.full((64, 128, 3), (0.5, 1.0, 2.0), np.float32)
    found = irradiance.on_normals(light, AXES)
    np.testing.assert_allclose(found, np.tile((0.5, 1.0, 2.0), (6, 1)), rtol=0.01)


@pytest.mark.parametrize("axis", range(6))
def test_a_lamp_lights_what_looks_at_it(axis: int) -> None:
    ways, size = irradiance.directions(64, 128)
    lamp = (ways @ AXES[axis] > 0.99)[..., None] * np.ones(3, np.float32)
    found = irradiance.on_normals(lamp.astype(np.float32), AXES)[:, 0]
    assert found[axis] == pytest.approx((lamp * size[..., None]).sum() / 3 / np.pi, rel=0.08)
    assert found[(axis + 3) % 6] == 0 and found.argmax() == axis
    assert np.delete(found, (axis, (axis + 3) % 6)).max() < 0.1 * found[axis]


def test_rays_are_as_dense_as_matt_surfaces_see() -> None:
    rays = irradiance.hemisphere(2000)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-5)
    assert rays[:, 2].mean() == pytest.approx(2 / 3, abs=0.01)
    turns = irradiance.frames(AXES)
    np.testing.assert_allclose(turns[..., 2], AXES)
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_allclose(np.linalg.det(turns), 1)


def test_a_plate_under_an_object_is_found_and_no_foot_is() -> None:
    plate, thing = box((-1, -1, -0.01), (1, 1, 0)), box((-0.5, -0.5, 0), (0.5, 0.5, 2))
    top = support.top_of(np.concatenate([plate, thing]))
    assert top is not None and 0 < top < 0.05
    assert support.top_of(thing) is None
    small = box((-0.45, -0.45, 0), (0.45, 0.45, 0.1))  # a step that the object is wider than
    head = box((-0.5, -0.5, 0.1), (0.5, 0.5, 2))
    assert support.top_of(np.concatenate([small, head])) is None
    table = box((-1, -1, -1), (1, 1, 0))  # much of it is below: it is a part of the object
    assert support.top_of(np.concatenate([table, box((-0.5, -0.5, 0), (0.5, 0.5, 3))])) is None
    assert support.top_of(np.zeros((0, 3, 3), np.float32)) is None


def test_points_are_spread_by_area_and_the_near_ones_are_seen() -> None:
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [3, 0, 0], [0, 3, 0]]])
    faces, weights = little_picture.points_on(corners.astype(np.float32), 10_000)
    assert (faces == 1).mean() == pytest.approx(0.9, abs=0.02)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    assert weights.min() >= 0
    cube = box((0, 0, 0), (1, 1, 1))
    faces, weights = little_picture.points_on(cube, 100_000)
    places = (cube[faces] * weights[..., None]).sum(axis=1)
    colours = (places > 0.5).astype(np.float32)
    found = little_picture.picture(places, colours, 64)
    assert found.shape == (64, 64, 4) and found[0, 0, 3] == 0
    assert found[32, 32, 3] == 1 and 0.2 < found[..., 3].mean() < 0.9
    assert found[10:14, 30:34, 2].mean() > 0.9  # its top is above
    assert found[50:54, 30:34, 2].mean() < 0.1
    front = found[found[..., 3] > 0]
    assert (front[:, 1] < 0.5).mean() > 0.5  # its front is near
    assert not little_picture.picture(places[:0], colours[:0], 8).any()
