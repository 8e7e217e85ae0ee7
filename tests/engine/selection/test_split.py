"""Held-out photos: near and far, every box its share, always some left to train on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roigs_engine.errors import ConfigError, SceneError
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.selection.split import choose_test_views

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)


def box(index: int) -> OrientedBox:
    """A box about point `index` of `scene_of`."""
    return OrientedBox.between(f"box {index}", [10 * index - 1, -1, -1], [10 * index + 1, 1, 1])


def scene_of(seen: list[set[int]], distances: list[float] | None = None) -> SfmScene:
    """One photo for each set of points it sees; point k lies at x = 10 k."""
    count = 1 + max(max(points, default=0) for points in seen)
    images = []
    for index, points in enumerate(seen):
        pose = np.eye(4)
        pose[2, 3] = distances[index] if distances else index + 3.0
        images.append(
            PosedImage(
                name=f"{index:03d}.jpg",
                path=Path("none.jpg"),
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=np.array(sorted(points), dtype=np.int64),
            )
        )
    points = np.zeros((count, 3))
    points[:, 0] = 10 * np.arange(count)
    return SfmScene(images=tuple(images), points=points, colors=np.zeros((count, 3), np.uint8))


def test_every_nth_by_distance() -> None:
    rng = np.random.default_rng(0)
    distances = rng.permutation(24) + 3.0
    scene = scene_of([{0}] * 24, distances.tolist())
    chosen = choose_test_views(scene, [box(0)], every=8)
    ranks = sorted(int(distances[int(name[:3])] - 3) for name in chosen)
    assert ranks == [4, 12, 20]
    assert list(chosen) == sorted(chosen)


def test_photos_that_do_not_see_the_box_are_never_taken() -> None:
    scene = scene_of([{0} if k % 2 else set() for k in range(40)])
    chosen = choose_test_views(scene, [box(0)], every=4)
    assert len(chosen) == 5
    assert all(int(name[:3]) % 2 for name in chosen)


def test_views_already_held_out_count_for_the_next_box() -> None:
    scene = scene_of([{0, 1}] * 16)
    assert choose_test_views(scene, [box(0), box(1)]) == choose_test_views(scene, [box(0)])


def test_next_box_gets_its_own_share_from_near_to_far() -> None:
    scene = scene_of([{0}] * 16 + [{1}] * 32)
    chosen = choose_test_views(scene, [box(0), box(1)])
    own = [int(name[:3]) - 16 for name in chosen if int(name[:3]) >= 16]
    assert own == [4, 12, 20, 28]


def test_two_photos_are_enough_and_one_is_not() -> None:
    assert len(choose_test_views(scene_of([{0}, {0}]), [box(0)])) == 1
    with pytest.raises(SceneError, match="box 0"):
        choose_test_views(scene_of([{0}, set()]), [box(0)])


def test_a_box_whose_every_photo_would_be_held_out_is_refused() -> None:
    # Held out for box 0 by distance: 001 and 003, all that see box 1.
    scene = scene_of([{0}, {0, 1}, {0}, {0, 1}])
    with pytest.raises(SceneError, match="box 1"):
        choose_test_views(scene, [box(0), box(1)], every=2)


@pytest.mark.parametrize("every", [1, -8])
def test_impossible_share(every: int) -> None:
    with pytest.raises(ConfigError):
        choose_test_views(scene_of([{0}] * 8), [box(0)], every=every)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 10), st.integers(1, 3))
def test_shares_hold_for_any_scene(seed: int, every: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    seen = [set(np.flatnonzero(rng.random(count) < 0.6).tolist()) for _ in range(60)]
    for index in range(count):
        seen[index].add(index)
        seen[index + 3].add(index)
    scene, rois = scene_of(seen), [box(index) for index in range(count)]
    chosen = set(choose_test_views(scene, rois, every))
    assert chosen == set(choose_test_views(scene, rois, every))
    for index in range(count):
        views = {image.name for image in scene.images if index in image.point_indices}
        assert 1 <= len(views & chosen) < len(views)
        # The first box: every n-th from the middle of the first n.
        skipped = 0 if index else min(every // 2, len(views) // 2)
        assert len(views & chosen) >= math.ceil((len(views) - skipped) / every)
