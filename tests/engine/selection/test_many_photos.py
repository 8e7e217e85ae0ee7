"""Selection among very many photos: its work and memory are limited."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.many_photos import grid_poses
from roigs_engine.model import visibility
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.selection import METHODS, SelectionConfig, select_cameras
from roigs_engine.selection.coverage import Coverage
from roigs_engine.selection.methods import Method

BOX = OrientedBox.between("box", [-1, -1, -1], [1, 1, 1])
CAMERA = Camera(width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0)


def scene(photos: int, points: int, tracks: bool = False) -> SfmScene:
    """A grid of cameras that all see the box, which all points are in."""
    rng, images = np.random.default_rng(0), []
    for index, pose in enumerate(grid_poses(photos)):
        seen = np.flatnonzero(rng.random(points) < 0.5) if tracks else np.zeros(0, np.int64)
        images.append(
            PosedImage(
                name=f"{index:04d}.jpg",
                path=None,
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=seen,
            )
        )
    places = rng.uniform(-1, 1, (points, 3))
    colors = np.zeros((points, 3), np.uint8)
    return SfmScene(images=tuple(images), points=places, colors=colors, has_tracks=tracks)


@pytest.mark.parametrize("photos", [16, 64])
def test_without_tracks_the_points_that_are_projected_are_limited(
    photos: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visibility, "MAX_OBSERVATIONS", 3000)
    monkeypatch.setattr(visibility, "MAX_PROJECTED", 5000)
    projected = []
    project = visibility._projected

    def counted(image, points, *bounds):
        projected.append(points.shape[1])
        return project(image, points, *bounds)

    monkeypatch.setattr(visibility, "_projected", counted)
    found = visibility.find_candidates(scene(photos, 1000), BOX)
    assert len(found) == photos
    assert len(found.obs_view) <= 3000
    assert sum(projected) <= 3000 + 5000
    assert f"one in {-(-1000 * photos // 3000)} of those in the box" in found.flags[0]


@pytest.mark.parametrize("method", METHODS)
def test_of_very_many_points_and_observations_every_second_third_counts(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = select_cameras(scene(30, 600, tracks=True), BOX, SelectionConfig(method=method))
    monkeypatch.setattr(visibility, "MAX_POINTS", 250)
    monkeypatch.setattr(visibility, "MAX_OBSERVATIONS", 5000)
    found = visibility.find_candidates(scene(30, 600, tracks=True), BOX)
    fewer = found.thinned()
    assert len(fewer) == len(found) == 30
    assert len(fewer.points) == 200
    np.testing.assert_array_equal(fewer.points, found.points[::3])
    pairs = set(zip(fewer.obs_view.tolist(), fewer.obs_point.tolist(), strict=True))
    assert pairs == {
        (view, point // 3)
        for view, point in zip(found.obs_view.tolist(), found.obs_point.tolist(), strict=True)
        if point % 3 == 0
    }
    some = select_cameras(scene(30, 600, tracks=True), BOX, SelectionConfig(method=method))
    assert some.candidates == whole.candidates
    assert some.features == whole.features  # of all points
    assert len(some.names) == len(whole.names)
    assert some.scores == pytest.approx(whole.scores, abs=0.1)


def test_photos_that_see_none_of_the_points_that_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visibility, "MAX_POINTS", 1)
    given = scene(4, 12, tracks=True)
    given = SfmScene(
        images=tuple(
            PosedImage(**{**vars(image), "point_indices": np.array([1])}) for image in given.images
        ),
        points=given.points,
        colors=given.colors,
    )
    for method in METHODS:
        config = SelectionConfig(method=method, count=3)
        assert len(select_cameras(given, BOX, config).names) == 3


def test_what_photos_show_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Counted(Coverage):
        def __init__(self, *args) -> None:
            made.append(args)
            super().__init__(*args)

    monkeypatch.setattr("roigs_engine.selection.coverage.Coverage", Counted)
    method = METHODS["coverage"]
    monkeypatch.setitem(METHODS, "coverage", Method(method.order, score=Counted))
    select_cameras(scene(20, 100, tracks=True), BOX, SelectionConfig())
    assert len(made) == 1
