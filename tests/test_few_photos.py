"""Captures cut down to a few photos: how many, which ones, and the points that are left."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.few_photos import KINDS, Case, cut
from roigs_engine.model.scene import SfmScene
from tests.engine.synthetic_scene import BOX, make_scene

VIEWS = 12


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    """A ring of cameras in order, each of which observes a third of the points, at random."""
    made, rng = make_scene(tmp_path_factory.mktemp("photos"), VIEWS), np.random.default_rng(0)
    images = tuple(
        replace(image, point_indices=np.flatnonzero(rng.random(len(made.points)) < 1 / 3))
        for image in made.images
    )
    return replace(made, images=images)


def few(scene: SfmScene, kind: str, count: int, seed: int = 0) -> SfmScene:
    return cut(scene, BOX, Case(scene="ball", kind=kind, count=count, seed=seed))


def gaps(scene: SfmScene) -> list[int]:
    """From each photo to the next one around the ring, in photos of the whole capture."""
    kept = [int(Path(image.name).stem) for image in scene.images]
    return [(b - a) % VIEWS for a, b in zip(kept, [*kept[1:], kept[0]], strict=True)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_has_its_number_of_photos_and_the_points_that_two_of_them_see(
    scene: SfmScene, kind: str
) -> None:
    for count in (4, 7):
        made = few(scene, kind, count)
        assert len(made.images) == len({image.name for image in made.images}) == count
        before = {image.name: scene.points[image.point_indices] for image in scene.images}
        seen = Counter(tuple(p) for image in made.images for p in before[image.name])
        good = {point for point, times in seen.items() if times >= 2}
        assert 0 < len(good) < len(scene.points)
        assert {tuple(point) for point in made.points} == good
        assert len(made.points) == len(made.colors) == len(good)
        for image in made.images:
            kept = {tuple(point) for point in made.points[image.point_indices]}
            assert kept == {tuple(point) for point in before[image.name]} & good


def test_an_arc_is_contiguous_and_even_photos_are_spread(scene: SfmScene) -> None:
    for seed in range(5):
        assert sorted(gaps(few(scene, "arc", 4, seed))) == [1, 1, 1, VIEWS - 3]
        assert gaps(few(scene, "even", 4, seed)) == [3, 3, 3, 3]
        assert set(gaps(few(scene, "even", 5, seed))) == {2, 3}


def test_a_case_is_the_same_every_time_and_another_seed_has_other_photos(scene: SfmScene) -> None:
    def names(kind: str, seed: int) -> tuple[str, ...]:
        return tuple(image.name for image in few(scene, kind, 4, seed).images)

    for kind in KINDS:
        assert names(kind, 0) == names(kind, 0)
        assert len({names(kind, seed) for seed in range(5)}) > 1


def test_more_photos_than_there_are_and_a_capture_without_tracks(scene: SfmScene) -> None:
    for kind in KINDS:
        assert [image.name for image in few(scene, kind, 99).images] == [
            image.name for image in scene.images
        ]
    none = np.zeros(0, dtype=np.int64)
    images = tuple(replace(image, point_indices=none) for image in scene.images)
    blind = replace(scene, images=images, has_tracks=False)
    assert len(few(blind, "random", 4).points) == len(scene.points)
