"""The up direction: from level photos with any pitch, in any frame."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.formats.gravity import gravity_alignment
from tests.poses import look_at

UP = np.array([0.0, 0.0, 1.0])


def photos(count: int = 40, *, arc: float = 1.0, roll: float = 0.0, portraits: float = 0.0):
    """(N, 4, 4) poses around the origin from above, z up; most look down on one side.

    Portraits have their top at the left, as phones store them.
    """
    random = np.random.default_rng(0)
    poses = []
    for k in range(count):
        angle = 2 * np.pi * arc * k / count
        eye = np.array([4 * np.cos(angle), 4 * np.sin(angle), 2.0 + 1.5 * np.cos(angle)])
        pose = look_at(eye, np.zeros(3))
        if pose[1, 2] > 0:  # the helper's own up may be another
            pose[:2] *= -1
        turn = random.normal(scale=np.radians(roll)) + (
            -np.pi / 2 if k % 20 < 20 * portraits else 0
        )
        about = np.eye(4)
        about[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        poses.append(about @ pose)
    return np.array(poses)


def turned(poses: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The same photos in a frame that is rotated."""
    frame = np.eye(4)
    frame[:3, :3] = rotation.T
    return poses @ frame


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def test_the_helper_has_z_up() -> None:
    x, y = photos()[:, 0, 2], photos()[:, 1, 2]
    assert np.abs(x).max() < 1e-6 and y.max() < 0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("portrait", [False, True])
def test_up_is_found_in_any_frame(seed: int, portrait: bool) -> None:
    frame = rotation(seed)
    level = gravity_alignment(turned(photos(roll=1.5, portraits=float(portrait)), frame))
    assert degrees(level @ frame @ UP, UP) < 1.0
    np.testing.assert_allclose(level @ level.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(level) == pytest.approx(1)


def test_photos_that_look_down_on_one_side_do_not_tilt_it() -> None:
    frame = rotation(7)
    level = gravity_alignment(turned(photos(arc=0.5), frame))
    assert degrees(level @ frame @ UP, UP) < 0.01


@pytest.mark.parametrize("roll", [0.0, 1.5, 8.0])
def test_a_level_model_is_left_alone(roll: float) -> None:
    np.testing.assert_array_equal(gravity_alignment(photos(roll=roll)), np.eye(3))


def test_a_level_model_with_another_axis_up_is_turned_by_right_angles() -> None:
    frame = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z becomes y
    level = gravity_alignment(turned(photos(roll=1.5), frame))
    assert set(np.unique(level.round(12))) <= {-1.0, 0.0, 1.0}
    np.testing.assert_allclose(level @ frame @ UP, UP, atol=1e-12)


def test_a_model_that_is_really_tilted_is_levelled() -> None:
    angle = np.radians(5)
    tilt = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    level = gravity_alignment(turned(photos(roll=1.0), tilt))
    assert degrees(level @ tilt @ UP, UP) < 1.0


def test_photos_that_look_one_way_take_their_own_up() -> None:
    one = turned(photos()[:1].repeat(4, axis=0), rotation(3))
    level = gravity_alignment(one)
    assert degrees(level @ -one[0, 1, :3], UP) < 1e-6


def test_without_photos_nothing_is_turned() -> None:
    np.testing.assert_array_equal(gravity_alignment(np.zeros((0, 4, 4))), np.eye(3))


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4])
def test_a_few_portraits_among_landscapes_do_not_turn_the_world_over(share: float) -> None:
    frame = rotation(11)
    level = gravity_alignment(turned(photos(roll=2, portraits=share), frame))
    assert degrees(level @ frame @ UP, UP) < 15


def test_a_tilt_over_a_facade_is_no_pan_of_portraits() -> None:
    random = np.random.default_rng(0)
    poses = []
    for _ in range(20):
        heading, pitch = np.radians(random.normal(0, 8)), np.radians(random.normal(0, 20))
        ahead = [np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), np.sin(pitch)]
        pose = look_at(np.zeros(3), np.array(ahead))
        if pose[1, 2] > 0:
            pose[:2] *= -1
        poses.append(pose)
    frame = rotation(12)
    level = gravity_alignment(turned(np.array(poses), frame))
    assert degrees(level @ frame @ UP, UP) < 15


def test_photos_from_straight_above() -> None:
    poses = []
    for k in range(12):
        angle = 2 * np.pi * k / 12
        right = np.array([np.cos(angle), np.sin(angle), 0])
        forward = -UP
        pose = np.eye(4)
        pose[:3, :3] = right, np.cross(forward, right), forward
        poses.append(pose)
    frame = rotation(13)
    level = gravity_alignment(turned(np.array(poses), frame))
    assert degrees(level @ frame @ UP, UP) < 1


def test_few_photos_are_not_snapped_far() -> None:
    angle = np.radians(10)
    tilt = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    level = gravity_alignment(turned(photos(4, roll=4), tilt))
    assert not np.array_equal(level, np.eye(3))
