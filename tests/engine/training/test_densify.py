"""Adaptive density control: what is cloned, split and pruned, and what follows an edit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.rotations import rotation_matrices
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.edits import clone_and_split, morton_order, unchanged
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl, RunningDensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.stage_data import StageData

BOX = OrientedBox.between("box", [-1, -1, -1], [1, 1, 1])
IN_BOXES, EVERYWHERE = BoxDensityControl(), DensityControl()

normalized = torch.nn.functional.normalize


def model(count: int, seed: int = 0, spread: float = 2.0) -> Gaussians:
    rng = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=spread * (2 * torch.rand(count, 3, generator=rng) - 1),
        quats=torch.randn(count, 4, generator=rng),
        log_scales=torch.rand(count, 3, generator=rng) * 2 - 4,
        logit_opacities=torch.randn(count, generator=rng),
        sh=torch.randn(count, 4, 3, generator=rng),
    )


def stats(gradient: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sums of gradients, and of views, after one."""
    return gradient, torch.ones_like(gradient)


@dataclass(frozen=True)
class Training:
    """The parts of a trainer that density control needs."""

    data: StageData
    gaussians: Gaussians


def control(
    settings: DensityControl,
    made: tuple[torch.Tensor, torch.Tensor],
    rois: Sequence[OrientedBox] = (),
    budgets: tuple[int, ...] | None = None,
    extent: float = 10.5,
) -> RunningDensityControl:
    """The density control of a stage whose photos have shown this."""
    if budgets is not None:
        settings = replace(settings, budgets=budgets)
    data = StageData(images=[], photos=None, photo_at=lambda step: 0, extent=extent, rois=rois)
    training = Training(data, model(len(made[0]), spread=0.0))
    chosen = settings.begin(TrainConfig(steps=100), training)
    if budgets is not None:
        chosen.began = torch.tensor(budgets)
    chosen.gradient, chosen.views = made
    return chosen


def rng() -> torch.Generator:
    return torch.Generator().manual_seed(1)


@given(st.integers(1, 40), st.integers(0, 1000))
def test_clones_and_splits_are_counted_and_traced(count: int, seed: int) -> None:
    before = model(count, seed)
    draw = np.random.default_rng(seed)
    chosen = torch.from_numpy(draw.random(count) < 0.5)
    reference = torch.full((count,), 1.0)
    large = before.log_scales.exp().amax(dim=1) > 0.05
    edit = clone_and_split(before, chosen, reference, 0.05, rng())
    clones, splits = int((chosen & ~large).sum()), int((chosen & large).sum())
    assert len(edit.gaussians) == len(edit.rows) == count + clones + splits
    assert int((edit.rows == -1).sum()) == clones + 2 * splits
    # Unsplit Gaussians stay as they were, in place and with their optimiser state.
    old = edit.rows >= 0
    assert edit.rows[old].tolist() == torch.nonzero(~(chosen & large)).flatten().tolist()
    for name in NAMES:
        after = getattr(edit.gaussians, name)
        assert torch.equal(after[old], getattr(before, name)[edit.rows[old]])
    newborn = Gaussians(**{n: t[~old] for n, t in edit.gaussians.tensors().items()})
    for name in NAMES:
        copies = getattr(newborn, name)[:clones]
        assert torch.equal(copies, getattr(before, name)[chosen & ~large])


def test_children_of_a_split_are_smaller_and_near() -> None:
    before = model(400)
    chosen = torch.ones(len(before), dtype=torch.bool)
    edit = clone_and_split(before, chosen, torch.zeros(len(before)), 0.01, rng())
    assert len(edit.gaussians) == 2 * len(before)
    parents = torch.arange(len(before)).repeat(2)
    scales = before.log_scales[parents].exp()
    ratio = scales / edit.gaussians.log_scales.exp()
    assert torch.allclose(ratio, torch.full_like(ratio, 1.6), rtol=1e-4)
    turned = rotation_matrices(normalized(before.quats))[parents]
    moved = edit.gaussians.means - before.means[parents]
    sigmas = (turned.transpose(1, 2) @ moved[..., None])[..., 0] / scales
    # 2400 normal samples: about one in 16,000 lies beyond 4 standard deviations.
    assert float((sigmas.abs() < 4).float().mean()) > 0.999
    assert 0.95 < float(sigmas.std()) < 1.05
    assert torch.equal(edit.gaussians.sh, before.sh[parents])
    assert torch.equal(edit.gaussians.logit_opacities, before.logit_opacities[parents])


def test_splits_depend_on_the_generator_only() -> None:
    before, chosen = model(20), torch.ones(20, dtype=torch.bool)
    first, second = (
        clone_and_split(before, chosen, torch.zeros(20), 0.01, rng()) for _ in range(2)
    )
    assert torch.equal(first.gaussians.means, second.gaussians.means)


def test_only_gaussians_in_the_box_are_chosen() -> None:
    gaussians = model(300)
    high = stats(torch.ones(300))
    chosen = control(IN_BOXES, high, [BOX], None).densify_mask(gaussians, 0)
    assert torch.equal(chosen, gaussians.in_box(BOX))
    assert 0 < int(chosen.sum()) < 300
    everywhere = control(EVERYWHERE, high, [BOX], None).densify_mask(gaussians, 0)
    assert bool(everywhere.all())


def test_the_threshold_is_on_the_mean_over_views_that_saw_it() -> None:
    density = control(EVERYWHERE, stats(torch.zeros(3)))
    density.follow(torch.arange(3), model(3))
    density.observe(torch.tensor([True, True, False]), torch.tensor([3e-4, 3e-4, 0.0]), None)
    density.observe(torch.tensor([True, False, False]), torch.tensor([0.0, 0.0, 0.0]), None)
    assert density.mean_gradient().tolist() == pytest.approx([1.5e-4, 3e-4, 0.0])
    chosen = density.densify_mask(model(3), 0)
    assert chosen.tolist() == [False, True, False]


@pytest.mark.parametrize("room", [-5, 0, 1, 7, 1000])
def test_budget_keeps_the_largest_gradients(room: int) -> None:
    gaussians = model(300)
    gradient = torch.linspace(1e-3, 1e-2, 300)
    inside = gaussians.in_box(BOX)
    held = int(inside.sum())
    chosen = control(IN_BOXES, stats(gradient), [BOX], (held + room,)).densify_mask(gaussians, 0)
    expected = max(0, min(room, held))
    assert int(chosen.sum()) == expected
    best = torch.nonzero(inside).flatten()[-expected:] if expected else torch.zeros(0)
    assert torch.nonzero(chosen).flatten().tolist() == best.int().tolist()


def test_each_box_has_its_own_budget() -> None:
    gaussians = model(400)
    left = OrientedBox.between("left", [-2, -2, -2], [0, 2, 2])
    right = OrientedBox.between("right", [0, -2, -2], [2, 2, 2])
    held = [int(gaussians.in_box(box).sum()) for box in (left, right)]
    budgets = held[0] + 3, held[1] + 8
    chosen = control(IN_BOXES, stats(torch.ones(400)), [left, right], budgets).densify_mask(
        gaussians, 0
    )
    assert int(chosen[gaussians.in_box(left)].sum()) == 3
    assert int(chosen[gaussians.in_box(right)].sum()) == 8


def test_outside_the_boxes_another_threshold_may_densify_without_budgets() -> None:
    gaussians = model(300)
    inside, gradient = gaussians.in_box(BOX), torch.linspace(0, 3e-4, 300)
    config = replace(IN_BOXES, grad_threshold=1e-4, outside_threshold=2e-4)
    chosen = control(config, stats(gradient), [BOX], None).densify_mask(gaussians, 0)
    assert torch.equal(chosen, gradient > torch.where(inside, 1e-4, 2e-4))
    full = control(config, stats(gradient), [BOX], (int(inside.sum()),)).densify_mask(gaussians, 0)
    assert torch.equal(full, chosen & ~inside)


def test_boxes_may_have_a_threshold_and_limits_of_their_own() -> None:
    gaussians = model(300)
    inside, gradient = gaussians.in_box(BOX), torch.linspace(0, 3e-4, 300)
    config = BoxDensityControl(grad_threshold=1e-4, outside_threshold=2e-4, box_sizes=False)
    chosen = control(config, stats(gradient), [BOX], None).densify_mask(gaussians, 0)
    assert torch.equal(chosen, gradient > torch.where(inside, 1e-4, 2e-4))
    room = 3
    limited = control(config, stats(gradient), [BOX], (int(inside.sum()) + room,)).densify_mask(
        gaussians, 0
    )
    assert torch.equal(limited[~inside], chosen[~inside])
    assert limited[inside].nonzero()[:, 0].tolist() == list(range(int(inside.sum())))[-room:]


def test_the_size_reference_is_the_box_inside_and_the_scene_outside() -> None:
    gaussians = model(50)
    reference = control(IN_BOXES, stats(torch.zeros(50)), [BOX], extent=10.0).size_reference(
        gaussians
    )
    inside = gaussians.in_box(BOX)
    assert torch.allclose(reference[inside], torch.tensor(BOX.diagonal))
    assert bool((reference[~inside] == 10.0).all())
    small = control(IN_BOXES, stats(torch.zeros(50)), [BOX], extent=0.5).size_reference(gaussians)
    assert bool((small == 0.5).all())
    for kind in (EVERYWHERE, replace(IN_BOXES, box_sizes=False)):
        anywhere = control(kind, stats(torch.zeros(50)), [BOX], extent=10.0)
        assert bool((anywhere.size_reference(gaussians) == 10.0).all())


def test_pruning_by_opacity_always_and_by_size_after_the_first_reset() -> None:
    gaussians = model(4)
    gaussians.logit_opacities[:] = torch.tensor([2.0, -6.0, 2.0, 2.0])  # sigmoid(-6) < 0.005
    gaussians.log_scales[:] = torch.tensor([0.1, 0.1, 1.2, 0.1])[:, None].log()
    config = DensityControl(prune_size=0.1, reset_every=3000)

    def keep(step: int, config: DensityControl = config) -> list[bool]:
        density = control(config, stats(torch.zeros(4)))
        return (~density.prune_mask(gaussians, step)).tolist()

    assert keep(3000) == [True, False, True, True]
    assert keep(3001) == [True, False, False, True]
    assert keep(9000, DensityControl(reset_every=0)) == [True, False, True, True]


def test_edits_can_be_thinned_and_reordered() -> None:
    gaussians = model(5)
    edit = unchanged(gaussians)
    assert edit.rows.tolist() == [0, 1, 2, 3, 4]
    mask = torch.tensor([True, False, True, True, False])
    thinned = edit.keep(mask)
    turned = thinned.keep(torch.tensor([2, 0, 1]))
    assert turned.rows.tolist() == [3, 0, 2]
    assert torch.equal(turned.gaussians.means, gaussians.means[[3, 0, 2]])


def test_statistics_after_an_edit() -> None:
    gaussians = model(3)
    density = control(EVERYWHERE, stats(torch.ones(3)))
    training = Training(density.data, gaussians)
    pruning = IdlePruning(every=1).begin(TrainConfig(steps=9), training)
    for weights in ([0.1, 0.2, 0.3], [0.3, 0.1, 0.2]):
        pruning.observe(torch.ones(3), torch.ones(3), torch.tensor(weights))
    assert pruning.state_dict()["weight"].tolist() == pytest.approx([0.3, 0.2, 0.3])
    for running in (density, pruning):
        running.follow(torch.tensor([2, -1, 0]), gaussians)
    assert density.gradient.tolist() == density.views.tolist() == [0, 0, 0]
    # A newborn has not been seen by every photo yet, so no window may call it useless.
    weight = pruning.state_dict()["weight"]
    assert weight.tolist() == pytest.approx([0.3, float("inf"), 0.3])


@given(st.integers(0, 200), st.integers(0, 1000))
def test_morton_order_is_a_permutation(count: int, seed: int) -> None:
    order = morton_order(model(count, seed).means)
    assert sorted(order.tolist()) == list(range(count))


def test_morton_order_puts_neighbours_together() -> None:
    means = model(4000).means
    order = morton_order(means)

    def path(rows: torch.Tensor) -> float:
        return float((means[rows][1:] - means[rows][:-1]).norm(dim=1).mean())

    assert path(order) < 0.2 * path(torch.arange(4000))


def test_morton_order_survives_far_and_equal_positions() -> None:
    means = torch.zeros(100, 3)
    assert morton_order(means).tolist() == list(range(100))
    means = model(1000).means
    means[0] = 1e6
    order = morton_order(means)
    inliers = order[order != 0]
    steps = (means[inliers][1:] - means[inliers][:-1]).norm(dim=1)
    shuffled = (means[1:-1] - means[2:]).norm(dim=1)
    assert float(steps.mean()) < 0.3 * float(shuffled.mean())


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(map(abs, q)) > 0.1))
def test_rotation_matrices_read_quaternions_as_wxyz(quat: list[float]) -> None:
    w, x, y, z = quat
    expected = Rotation.from_quat([x, y, z, w]).as_matrix()
    found = rotation_matrices(normalized(torch.tensor([quat], dtype=torch.float64)))[0].numpy()
    np.testing.assert_allclose(found, expected, atol=1e-12)
