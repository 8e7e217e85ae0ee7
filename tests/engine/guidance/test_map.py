"""The map of a box: what is seen, from where, how finely; and what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roigs_engine.errors import RoiError
from roigs_engine.guidance.box_map import DIRECTIONS, filling_distance, with_sharpness
from roigs_engine.guidance.certificate import certificate
from roigs_engine.guidance.figures import pixels_across, sides_without_photos
from roigs_engine.guidance.known import KnownBox, known_box
from roigs_engine.guidance.suggest import suggested
from roigs_engine.guidance.words import Units
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene, project
from tests.engine.guidance.ball import AWAY, BOX, CAMERA, HEIGHT, RADIUS, VIEWS, ball_scene

HALF = tuple(np.pi * np.arange(13) / 12 - np.pi / 2)
"""Angles of photos from the side of +x alone."""


@pytest.fixture(scope="module")
def all_around() -> KnownBox:
    return known_box(ball_scene(), BOX, look=False)


@pytest.fixture(scope="module")
def one_side() -> KnownBox:
    return known_box(ball_scene(HALF), BOX, look=False)


def side(known: KnownBox, positive: bool) -> float:
    """Coverage of the directions on one side of the ball, along x."""
    weight, value = known.map.of_directions()
    rows = (known.map.directions[:, 0] * (1 if positive else -1) > 0.3) & (weight > 0)
    return float((value[rows] * weight[rows]).sum() / weight[rows].sum())


def test_a_photo_sees_the_side_of_the_ball_that_it_faces(all_around: KnownBox) -> None:
    found = all_around.map
    assert len(found.images) == VIEWS
    real = ~found.patches.guessed & (np.linalg.norm(found.patches.places, axis=1) < 1.01 * RADIUS)
    for column, image in enumerate(found.images):
        ways = image.centre - found.patches.places
        facing = (ways * found.patches.places).sum(axis=1) / np.linalg.norm(ways, axis=1) / RADIUS
        assert found.seen[real & (facing > 0.3), column].mean() > 0.95
        assert not found.seen[real & (facing < -0.2), column].any()


def test_pixels_per_length_are_those_of_the_photos(all_around: KnownBox) -> None:
    found = all_around.map
    for column, image in enumerate(found.images[:3]):
        depth = image.local(found.patches.places)[:, 2]
        seen = found.seen[:, column]
        assert found.density[seen, column] == pytest.approx(CAMERA.fx / depth[seen])
        assert not found.density[~seen, column].any()
    assert found.reference == pytest.approx(CAMERA.fx / filling_distance(BOX, CAMERA))


def test_the_box_just_fills_the_picture_at_that_distance() -> None:
    distance = filling_distance(BOX, CAMERA)
    # The cone of the picture's shorter side touches the sphere around the box.
    half = np.arctan(CAMERA.height / 2 / CAMERA.fy)
    assert distance * np.sin(half) == pytest.approx(BOX.diagonal / 2)


def test_a_side_without_photos_is_known_least(all_around: KnownBox, one_side: KnownBox) -> None:
    assert one_side.map.patches.guessed.any()  # the hull closes the ball where points end
    assert side(one_side, False) < 0.5 * side(one_side, True)
    assert side(all_around, False) == pytest.approx(side(all_around, True), rel=0.1)
    assert all_around.map.value > one_side.map.value


def test_the_first_photos_are_of_the_missing_side(one_side: KnownBox) -> None:
    shots = suggested(one_side, 4)
    assert len(shots) == 4
    assert all(shot.centre[0] < 0.3 for shot in shots[:3])
    gains = [shot.gain for shot in shots]
    assert gains == sorted(gains, reverse=True) and gains[-1] > 0
    values = [one_side.map.value, *(shot.value for shot in shots)]
    assert values == sorted(values) and values[-1] > values[0]


def test_suggested_photos_are_from_where_a_person_stands(all_around: KnownBox) -> None:
    scene = ball_scene()
    for shot in suggested(all_around, 8):
        assert shot.centre[2] == pytest.approx(HEIGHT, abs=1e-6) or shot.centre[2] > -RADIUS
        heights = scene.centres()[:, 2]
        assert heights.min() - 1e-9 <= shot.centre[2] <= heights.max() + 1e-9
        assert shot.distance >= filling_distance(BOX, CAMERA) * 0.999
        pose = shot.world_to_camera
        assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3))
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        middle = pose[:3, :3] @ BOX.centre + pose[:3, 3]
        assert middle[:2] == pytest.approx([0, 0], abs=1e-9) and middle[2] > 0
        assert pose[1, :3] @ [0, 0, 1] < 0  # upright: y points down


def test_more_photos_never_tell_less_and_add_less_the_more_there_are() -> None:
    few = known_box(ball_scene(HALF[::3]), BOX, look=False).map
    assert few.weights.sum() == pytest.approx(1)
    assert few.known.shape == (len(few.patches), DIRECTIONS)
    assert 0 < few.value < 1
    information = few.information
    values = [(few.weights * k * information / (1 + k * information)).sum() for k in (1, 2, 3)]
    assert values[0] < values[1] < values[2]
    assert values[1] - values[0] > values[2] - values[1]


def test_a_wall_hides_the_ball() -> None:
    scene = ball_scene()
    rng = np.random.default_rng(1)
    wall = np.column_stack(
        [np.full(4000, 1.2), rng.uniform(-2, 2, 4000), rng.uniform(-0.4, 1, 4000)]
    )
    outside = [image for image in scene.images if image.centre[0] > 1.4]
    first = len(scene.points)
    points = np.concatenate([scene.points, wall])
    images = []
    for image in scene.images:
        rows = image.point_indices
        if image in outside:  # these see the wall alone
            seen = project(points, image.camera, image.world_to_camera)[2]
            rows = np.flatnonzero(seen & (np.arange(len(points)) >= first))
        images.append(replace(image, point_indices=rows.astype(np.int64)))
    colors = np.full((len(points), 3), 128, np.uint8)
    walled = SfmScene(images=tuple(images), points=points, colors=colors)
    found = known_box(walled, BOX, look=False).map
    names = {image.name for image in outside}
    hidden = [k for k, image in enumerate(found.images) if image.name in names]
    free = [k for k in range(len(found.images)) if k not in hidden]
    assert outside and found.seen[:, hidden].sum() < 0.05 * found.seen[:, free].sum()


def test_no_free_place_is_an_error() -> None:
    known = known_box(ball_scene(), BOX, look=False)
    nowhere = replace(known, places=replace(known.places, poses=np.zeros((0, 4, 4))))
    with pytest.raises(RoiError, match="no free place"):
        suggested(nowhere, 3)


def test_a_box_without_points_is_an_error() -> None:
    empty = OrientedBox.between("empty", [5, 5, 5], [6, 6, 6])
    with pytest.raises(RoiError, match="contains no sparse point"):
        known_box(ball_scene(), empty, look=False)


def test_cameras_at_several_distances_have_rings() -> None:
    known = known_box(ball_scene(), BOX, look=False)
    away = np.linalg.norm(known.places.centres - BOX.centre, axis=1)
    assert away.min() == pytest.approx(filling_distance(BOX, CAMERA))
    assert away.max() <= np.hypot(AWAY, HEIGHT) * 1.01 or len(np.unique(away.round(6))) == 1


def test_a_gap_is_found_by_map_guide_and_certificate(
    all_around: KnownBox, one_side: KnownBox
) -> None:
    """Photos of one side are removed: each tells it, and of the right side."""
    whole = certificate(all_around, Units(scale=None), {}, {})
    cut = certificate(one_side, Units(scale=None), {}, {})
    assert cut.covered < 0.8 * whole.covered and cut.known < whole.known
    weight, value = one_side.map.of_directions()
    least = one_side.map.directions[np.nanargmin(np.where(weight > 0, value, np.nan))]
    assert least[0] < 0
    first = suggested(one_side, 1)[0]
    assert first.centre[0] < 0 and first.gain > suggested(all_around, 1)[0].gain


def test_the_sharpness_of_photos_changes_the_sum_alone(all_around: KnownBox) -> None:
    found = all_around.map
    half = with_sharpness(found, np.full(len(found.images), 0.5))
    assert half.information == pytest.approx(found.information / 4)
    assert half.seen is found.seen and half.weights is found.weights


def test_sides_without_photos_are_those_of_the_missing_half(
    all_around: KnownBox, one_side: KnownBox
) -> None:
    """No camera is steeper than 20 degrees, and none can be below the table."""
    assert sides_without_photos(all_around.map) == ["+z"]
    assert sides_without_photos(one_side.map) == ["-x", "+z"]


def test_pixels_across_are_those_of_the_nearest_photos(all_around: KnownBox) -> None:
    """The box is a unit wide; patches look at the camera at an angle, and are nearer than it."""
    across = pixels_across(all_around.map)
    assert across == pytest.approx(CAMERA.fx / np.hypot(AWAY, HEIGHT), rel=0.25)
    assert pixels_across(replace(all_around.map, sharpness=np.full(VIEWS, 0.5))) == across / 2
