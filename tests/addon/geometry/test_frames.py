"""COLMAP frames and Blender frames, without Blender."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry import frames
from roigs_addon.geometry.box import ShearedBoxError, box_from_matrix
from roigs_addon.geometry.frames import Intrinsics, Lens
from roigs_addon.geometry.photo import Photo
from tests.poses import rotation

SEEDS = range(60)


def matrix(random: np.random.Generator, scale: object = 1.0) -> np.ndarray:
    """A rotation, a translation and a scale along the axes."""
    result = np.eye(4)
    result[:3, :3] = rotation(random) * scale
    result[:3, 3] = random.normal(size=3) * 5
    return result


def intrinsics(random: np.random.Generator) -> Intrinsics:
    width, height = (int(v) for v in random.integers(16, 8000, 2))
    fx = width * np.exp(random.uniform(-1.5, 2.5))
    return Intrinsics(
        width=width,
        height=height,
        fx=fx,
        fy=fx * np.exp(random.uniform(-1.2, 1.2)),
        cx=width * random.uniform(-0.5, 1.5),
        cy=height * random.uniform(-0.5, 1.5),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_lens_and_back(seed: int) -> None:
    k = intrinsics(np.random.default_rng(seed))
    lens = frames.lens_from_intrinsics(k)
    assert min(lens.aspect_x, lens.aspect_y) == 1.0
    assert vars(frames.intrinsics_from_lens(lens, k.width, k.height)) == pytest.approx(
        vars(k), rel=1e-12, abs=1e-9
    )


def test_what_the_conventions_say() -> None:
    k = Intrinsics(width=200, height=100, fx=300.0, fy=150.0, cx=90.0, cy=55.0)
    assert frames.lens_from_intrinsics(k) == Lens(
        lens=54.0, shift_x=0.05, shift_y=0.05, aspect_x=1.0, aspect_y=2.0
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_camera_pose_and_back_under_any_root(seed: int) -> None:
    random = np.random.default_rng(seed)
    pose, root = matrix(random), matrix(random, np.exp(random.uniform(-3, 3)))
    world = root @ frames.camera_matrix(pose)
    np.testing.assert_allclose(frames.world_to_camera(world, root), pose, atol=1e-11)


def test_a_camera_looks_along_minus_z_with_y_up() -> None:
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 5  # at z = -5, looking along +z, its y down
    local = frames.camera_matrix(pose)
    np.testing.assert_array_equal(local[:3, 3], [0, 0, -5])
    np.testing.assert_array_equal(local[:3, :3], np.diag([1, -1, -1]))


@pytest.mark.parametrize("seed", SEEDS)
def test_box_of_a_turned_scaled_and_mirrored_cube(seed: int) -> None:
    random = np.random.default_rng(seed)
    sides = random.uniform(0.1, 3, 3)
    signs = random.choice([-1, 1], 3)
    empty, root = matrix(random, sides * signs), matrix(random, random.uniform(0.1, 9))
    size = random.uniform(0.2, 2)
    box = box_from_matrix(root @ empty, root, size)
    turn = box.world_to_box[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(box.half_extents, sides * size)
    corners = np.array(np.meshgrid(*[[-0.99, 0.99]] * 3)).reshape(3, -1).T * size
    points = (corners @ empty[:3, :3].T + empty[:3, 3]).astype(np.float32)
    assert box.contains(points).all()
    outside = (1.03 * corners) @ empty[:3, :3].T + empty[:3, 3]
    assert not box.contains(outside.astype(np.float32)).any()


@pytest.mark.parametrize("seed", SEEDS[:20])
def test_moving_root_and_box_together_changes_nothing(seed: int) -> None:
    random = np.random.default_rng(seed)
    empty, root = matrix(random, random.uniform(0.1, 3, 3)), matrix(random)
    moved = matrix(random, random.uniform(0.1, 9))
    before = box_from_matrix(empty, root, 1.0)
    after = box_from_matrix(moved @ empty, moved @ root, 1.0)
    np.testing.assert_allclose(after.world_to_box, before.world_to_box, atol=1e-10)
    np.testing.assert_allclose(after.half_extents, before.half_extents)


def test_uneven_root_scale_keeps_an_aligned_box_and_slants_a_turned_one() -> None:
    root = np.diag([1.0, 2.0, 3.0, 1.0])
    box = box_from_matrix(np.eye(4), root, 1.0)
    np.testing.assert_allclose(box.half_extents, [1, 1 / 2, 1 / 3])
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]]
    with pytest.raises(ShearedBoxError, match="right angles"):
        box_from_matrix(turned, root, 1.0)


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf])
def test_a_flat_or_broken_cube_is_not_a_box(scale: float) -> None:
    with pytest.raises(ValueError, match="no volume"):
        box_from_matrix(np.diag([1.0, scale, 1.0, 1.0]), np.eye(4), 1.0)


def test_a_photos_record_is_exact() -> None:
    random = np.random.default_rng(1)
    rows = tuple(tuple(row) for row in matrix(random).tolist())
    photo = Photo(
        name="für/a “b”.jpg", path="", intrinsics=intrinsics(random), world_to_camera=rows
    )
    assert Photo.from_json(photo.to_json()) == photo


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"name": 1}', "nonsense", "[" * 100_000])
def test_a_broken_record_has_no_photo(text: str) -> None:
    assert Photo.from_json(text) is None


def test_the_edges_of_a_picture_in_clip_space() -> None:
    k = Intrinsics(width=200, height=100, fx=300.0, fy=150.0, cx=90.0, cy=55.0)
    clip = frames.clip_matrix(k)
    for x, y, place in ((0, 0, (-1, -1)), (200, 100, (1, 1)), (90, 55, (-0.1, 0.1))):
        for depth in (0.5, 4.0):
            point = np.array([(x - k.cx) / k.fx * depth, (y - k.cy) / k.fy * depth, depth, 1])
            found = clip @ point
            assert found[3] == depth
            np.testing.assert_allclose(found[:2] / depth, place, atol=1e-12)
