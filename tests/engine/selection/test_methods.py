"""The mathematics of camera selection: scores, greedy, coverage, gp, farthest views."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roigs_engine.model.mask_coverage import object_points
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PhotoMask, PosedImage
from roigs_engine.model.visibility import Candidates
from roigs_engine.selection.baselines import (
    farthest_first,
    order_fvs,
    order_random,
    order_static,
    view_positions,
)
from roigs_engine.selection.coverage import (
    Coverage,
    fibonacci_directions,
    nearest_direction,
    order_coverage,
)
from roigs_engine.selection.gp import FEATURE_NAMES, gp_inputs, order_gp
from roigs_engine.selection.greedy import order_greedy
from roigs_engine.selection.request import Request, StaticFeatures, static_features
from roigs_engine.selection.score import DensityOccupancy, prefix_values, voxel_indices
from tests.poses import look_at

CAMERA = Camera(width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0)
BOX = OrientedBox.between("box", [-1, -0.5, -1], [1, 0.5, 1])
UP = (0.1, 0.2, 1.0)  # no camera looks along it
seeds = st.integers(0, 10_000)


def instance(
    seed: int, views: int = 12, points: int = 30, share: float = 0.25, flat: bool = False
) -> Candidates:
    """Random photos around the box, each seeing a random share of random points in it."""
    rng = np.random.default_rng(seed)
    seen = rng.random((views, points)) < share
    seen[np.arange(views), rng.integers(0, points, views)] = True
    images = []
    for view in range(views):
        centre = rng.normal(size=3)
        centre *= rng.uniform(2.5, 8) / np.linalg.norm(centre)
        if flat:
            centre[2] = 0.5
        transform = look_at(centre, rng.uniform(-0.3, 0.3, 3), UP)
        images.append(
            PosedImage(
                name=f"{view:03d}.jpg",
                path=Path("none"),
                camera=CAMERA,
                world_to_camera=transform,
                point_indices=np.flatnonzero(seen[view]),
            )
        )
    obs_view, obs_point = np.nonzero(seen)
    return Candidates(
        roi=BOX,
        images=tuple(images),
        points=rng.uniform(-1, 1, (points, 3)) * BOX.half_extents,
        obs_view=obs_view,
        obs_point=obs_point,
    )


def wanted(candidates: Candidates, count: int, seed: int = 0) -> Request:
    features = static_features(candidates)
    return Request(candidates=candidates, features=features, count=count, seed=seed)


def points_and_voxels(candidates: Candidates, chosen) -> tuple[int, int]:
    """Points, and voxels holding one, that the chosen photos see: by sets, from the definition."""
    edge = 2 * BOX.half_extents.max() / 16
    seen = {
        int(p)
        for v, p in zip(candidates.obs_view, candidates.obs_point, strict=True)
        if v in chosen
    }
    low = -BOX.half_extents
    voxels = {tuple(np.floor((candidates.points[p] - low) / edge).astype(int)) for p in seen}
    return len(seen), len(voxels)


def naive_greedy(views: int, count: int, value) -> list[int]:
    """Best next photo by full evaluation, first of equals; stops when none adds anything."""
    order: list[int] = []
    while len(order) < count:
        rest = [v for v in range(views) if v not in order]
        values = [value([*order, v]) for v in rest]
        if max(values) <= value(order):
            break
        order.append(rest[int(np.argmax(values))])
    return order


@settings(max_examples=40)
@given(seeds)
def test_the_score_is_density_times_occupancy(seed):
    candidates = instance(seed)
    score = DensityOccupancy(candidates)
    all_points = len(candidates.points)
    all_voxels = voxel_indices(candidates.points, BOX).max() + 1
    chosen: list[int] = []
    for view in np.random.default_rng(seed).permutation(len(candidates)).tolist():
        gain = score.gains()
        before = score.value
        assert score.product_with(view) == math.prod(points_and_voxels(candidates, [*chosen, view]))
        score.add(view)
        chosen.append(view)
        points, voxels = points_and_voxels(candidates, chosen)
        assert score.value == pytest.approx(points / all_points * voxels / all_voxels)
        assert gain[view] == pytest.approx(score.value - before, abs=1e-12)


def test_voxels_are_cubes_and_both_ends_belong_to_the_box():
    points = np.array([[-1, -0.5, -1], [1, 0.5, 1], [-0.99, -0.49, -0.99], [-0.87, -0.5, -1]])
    assert len(set(voxel_indices(points, BOX).tolist())) == 3
    dense = np.random.default_rng(0).uniform(-1, 1, (200_000, 3)) * BOX.half_extents
    assert voxel_indices(dense, BOX).max() + 1 == 16 * 8 * 16


@settings(max_examples=40)
@given(seeds)
def test_lazy_greedy_takes_the_exact_argmax_at_every_step(seed):
    candidates = instance(seed, share=0.15)
    picks = order_greedy(wanted(candidates, 12))
    naive = naive_greedy(
        12, 12, lambda chosen: math.prod(points_and_voxels(candidates, set(chosen)))
    )
    assert list(picks.order[: len(naive)]) == naive
    assert bool(picks.flags) == (len(naive) < 12)
    assert sorted(picks.order) == list(range(12))


@settings(max_examples=40)
@given(seeds, st.sets(st.integers(0, 11)), st.sets(st.integers(0, 11)), st.integers(0, 11))
def test_coverage_is_monotone_and_submodular(seed, small, more, view):
    candidates = instance(seed)
    states = []
    for chosen in (small, small | more):
        coverage = Coverage(candidates)
        for member in sorted(chosen):
            coverage.add(member)
        states.append(coverage)
    assert states[0].value <= states[1].value + 1e-12
    assert states[0].gain(view) >= states[1].gain(view) >= 0
    before, gain = states[0].value, states[0].gain(view)
    states[0].add(view)
    assert states[0].value - before == pytest.approx(gain, abs=1e-12)
    assert states[0].gain(view) == 0


@settings(max_examples=30)
@given(seeds)
def test_lazy_coverage_equals_naive_greedy(seed):
    candidates = instance(seed)
    state, naive = Coverage(candidates), []
    for _ in range(12):
        gains = [-1.0 if v in naive else state.gain(v) for v in range(12)]
        if max(gains) <= 0:
            break
        naive.append(int(np.argmax(gains)))
        state.add(naive[-1])
    picks = order_coverage(wanted(candidates, 12))
    assert list(picks.order[: len(naive)]) == naive
    assert prefix_values(Coverage(candidates), picks.order)[-1] == pytest.approx(1)


def test_every_prefix_of_coverage_is_the_answer_for_fewer_photos():
    candidates = instance(4, views=20)
    full = order_coverage(wanted(candidates, 20)).order
    assert all(order_coverage(wanted(candidates, k)).order == full[:k] for k in (1, 5, 13))


def test_coverage_is_the_written_sum():
    # Six points in general position (too few for normals): F from the definition.
    candidates = instance(1, views=4, points=6, share=0.6)
    voxel = voxel_indices(candidates.points, BOX)
    directions = fibonacci_directions(32)
    rho, slots = [], []
    for view, point in zip(candidates.obs_view, candidates.obs_point, strict=True):
        image, position = candidates.images[view], candidates.points[point]
        depth = (image.world_to_camera[:3, :3] @ position + image.world_to_camera[:3, 3])[2]
        rho.append(150.0 / depth)
        ray = image.centre - position
        slots.append((int(point), int(np.argmax(directions @ ray))))
    best = np.percentile(rho, 90)

    def total(chosen) -> float:
        held: dict[tuple[int, int], float] = {}
        for view, slot, value in zip(candidates.obs_view, slots, rho, strict=True):
            if view in chosen:
                held[slot] = max(held.get(slot, 0.0), min(1.0, value / best))
        return sum(v / np.count_nonzero(voxel == voxel[slot[0]]) for slot, v in held.items())

    expected = [total({2}) / total({0, 1, 2, 3}), total({2, 0}) / total({0, 1, 2, 3})]
    assert prefix_values(Coverage(candidates), (2, 0)) == pytest.approx(expected)


def test_coverage_prefers_the_sharper_of_two_photos_in_one_direction():
    near, far = np.array([0.0, -3.0, 0.0]), np.array([0.0, -9.0, 0.0])
    images = tuple(
        PosedImage(
            name=name,
            path=Path("none"),
            camera=CAMERA,
            world_to_camera=look_at(centre, up=UP),
            point_indices=np.arange(3),
        )
        for name, centre in (("far.jpg", far), ("near.jpg", near))
    )
    candidates = Candidates(
        roi=BOX,
        images=images,
        points=np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0.1]]),
        obs_view=np.repeat([0, 1], 3),
        obs_point=np.tile(np.arange(3), 2),
    )
    assert order_coverage(wanted(candidates, 2)).order[0] == 1


def test_a_grazing_photo_counts_less_on_a_surface():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (60, 2)), np.zeros(60)])
    box = OrientedBox.between("table", [-0.5, -0.5, -0.1], [0.5, 0.5, 0.1])
    above, beside = np.array([0.0, 0.01, 5.0]), np.array([5.0, 0.01, 1.0])
    images = tuple(
        PosedImage(
            name=f"{i}.jpg",
            path=Path("none"),
            camera=CAMERA,
            world_to_camera=look_at(centre, up=UP),
            point_indices=np.arange(60),
        )
        for i, centre in enumerate((beside, above))
    )
    candidates = Candidates(
        roi=box,
        images=images,
        points=points,
        obs_view=np.repeat([0, 1], 60),
        obs_point=np.tile(np.arange(60), 2),
    )
    state = Coverage(candidates)
    # cos(theta) = 1 against about 0.2
    assert state.gain(0) < 0.35 * state.gain(1)


@pytest.mark.parametrize("bins", [26, 32, 48])
def test_direction_bins_are_even(bins):
    directions = fibonacci_directions(bins)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(bins))
    rays = np.random.default_rng(0).normal(size=(50_000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    index = nearest_direction(rays, directions)
    assert (index == np.argmax(rays @ directions.T, axis=1)).all()
    share = np.bincount(index, minlength=bins) * bins / len(rays)
    assert share.min() > 0.75 and share.max() < 1.25


def test_static_sums_ranks_and_ties_go_by_name():
    features = StaticFeatures(
        distance=np.array([3.0, 1.0, 2.0, 2.0]),
        area=np.array([0.1, 0.9, 0.5, 0.5]),
        keypoints=np.array([5.0, 50.0, 20.0, 20.0]),
        inside=np.zeros(4, bool),
    )
    request = replace(wanted(instance(0, views=4), 4), features=features)
    assert order_static(request).order == (1, 2, 3, 0)
    assert order_static(replace(request, count=2)).order == (1, 2)


def test_farthest_first_takes_the_farthest_from_all_taken():
    line = np.array([[0.0], [1.0], [5.0], [10.0]])
    assert farthest_first(line, [0], 4) == [0, 3, 2, 1]
    assert farthest_first(line, [1, 2], 3) == [1, 2, 3]


def test_fvs_spreads_more_than_random():
    candidates = instance(0, views=60)
    positions = view_positions(candidates)

    def closest_pair(order) -> float:
        chosen = positions[list(order)]
        distance = np.linalg.norm(chosen[:, None] - chosen[None], axis=2)
        return float(distance[np.triu_indices(len(chosen), 1)].min())

    spread = closest_pair(order_fvs(wanted(candidates, 12)).order)
    assert all(
        spread > closest_pair(order_random(wanted(candidates, 12, s)).order) for s in range(20)
    )


def test_random_follows_its_seed():
    candidates = instance(0, views=30)
    orders = [order_random(wanted(candidates, 10, seed)).order for seed in (1, 1, 2)]
    assert orders[0] == orders[1] != orders[2]


def gp_order(candidates: Candidates, extended: bool = True, count: int = 15, **options):
    return order_gp(wanted(candidates, count, **options), extended=extended)


@pytest.mark.parametrize(("extended", "options"), [(False, {}), (True, {"seed": 7})])
def test_gp_is_deterministic_and_silent(extended, options):
    candidates = instance(2, views=40, points=300, share=0.08)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first = gp_order(candidates, extended, **options)
    assert first == gp_order(candidates, extended, **options)
    assert len(set(first.order)) == 15


def test_gp_starts_with_the_most_keypoints_and_spread_directions():
    candidates = instance(3, views=40, points=300, share=0.08)
    order = gp_order(candidates).order
    assert order[0] == np.bincount(candidates.obs_view).argmax()
    assert list(order[:5]) == farthest_first(candidates.forwards(), [order[0]], 5)


def test_gp9_has_nine_inputs_and_drops_the_constant_ones():
    candidates = instance(0)
    features = static_features(candidates)
    for extended, size in ((False, 6), (True, 9)):
        inputs, names = gp_inputs(candidates, features, extended)
        assert inputs.shape == (12, size) and names == FEATURE_NAMES[:size]
        assert inputs.mean(axis=0) == pytest.approx(np.zeros(size), abs=1e-9)
        assert inputs.std(axis=0) == pytest.approx(np.ones(size))
    flat = instance(0, flat=True)
    inputs, names = gp_inputs(flat, static_features(flat), True)
    assert inputs.shape == (12, 8) and "position z" not in names
    picks = gp_order(flat, count=8)
    assert len(picks.order) == 8 and "position z" in picks.flags[0]


def test_gp_inputs_follow_the_box():
    """Turning the whole world about leaves the inputs as they are."""
    candidates = instance(5)
    turn = np.eye(4)
    turn[:3, :3] = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
    turn[:3, 3] = [3.0, -1.0, 2.0]
    back = np.linalg.inv(turn)
    turned = Candidates(
        roi=OrientedBox(
            name="t", world_to_box=BOX.world_to_box @ back, half_extents=BOX.half_extents
        ),
        images=tuple(
            PosedImage(
                name=i.name,
                path=i.path,
                camera=i.camera,
                world_to_camera=i.world_to_camera @ back,
                point_indices=i.point_indices,
            )
            for i in candidates.images
        ),
        points=candidates.points @ turn[:3, :3].T + turn[:3, 3],
        obs_view=candidates.obs_view,
        obs_point=candidates.obs_point,
    )
    before, _ = gp_inputs(candidates, static_features(candidates), True)
    after, _ = gp_inputs(turned, static_features(turned), True)
    assert after == pytest.approx(before, abs=1e-6)


def test_coverage_counts_the_objects_points_alone() -> None:
    candidates = instance(5)
    small = np.zeros((12, 16), np.uint8)
    small[:, :8] = 255
    mask = PhotoMask(digest="m", path=Path("m"), remake=lambda: None, small=small)
    images = (replace(candidates.images[0], objects={"box": mask}), *candidates.images[1:])
    masked = replace(candidates, images=images)
    shown = object_points(masked.points, BOX, images)
    assert 0 < shown.sum() < len(shown)
    plain, weighted = Coverage(candidates), Coverage(masked)
    starts = candidates.row_starts()
    for view in range(len(candidates)):
        seen = candidates.obs_point[starts[view] : starts[view + 1]]
        assert plain.gain(view) > 0 and (weighted.gain(view) > 0) == shown[seen].any()
    small[:] = 0  # a mask that shows none of the points says nothing about photos
    nothing = [replace(image, objects={"box": mask}) for image in candidates.images]
    assert Coverage(replace(candidates, images=tuple(nothing))).gain(0) == plain.gain(0)
