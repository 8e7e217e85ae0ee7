"""Training: it learns, it resumes bit for bit, and the box stage stays in the box."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError
from roigs_engine.formats.targets import PLAIN as PLAIN_3DGS
from roigs_engine.formats.targets import TARGETS, VIEWERS, Target
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.limits import (
    NO_LIMITS,
    PICTURE_LIMITS,
    TRAINING_LIMITS,
    training_limits,
)
from roigs_engine.training import photo_order
from roigs_engine.training import trainer as trainer_module
from roigs_engine.training.checkpoint import load_checkpoint, save_checkpoint
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.floater_pruning import FloaterPruning
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay
from roigs_engine.training.mechanisms.surroundings_rate import SurroundingsRate
from roigs_engine.training.mechanisms.warm_restarts import WarmRestarts
from roigs_engine.training.stage_data import StageData
from roigs_engine.training.trainer import Trainer
from tests.engine.settings import without
from tests.engine.synthetic_scene import BOX, make_scene, stage_data
from tests.engine.training.short import DENSITY, PLAIN, SHORT, first_model, same_bits

IN_BOXES = BoxDensityControl(start=10, until=50, every=10, grad_threshold=1e-5, reset_every=0)
RESTING = TrainConfig(steps=20)
MASKED = PLAIN.using(MaskedSteps(), SurroundingsRate(factor=2.0), DENSITY)
AVERAGED = PLAIN.using(replace(DENSITY, until=30), ModelAveraging(steps=25))
RESTARTED = SHORT.using(replace(DENSITY, until=25), WarmRestarts(count=2))
FADING = AVERAGED.using(OpacityDecay(share=0.1))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def floater(scene: SfmScene) -> np.ndarray:
    """A place close before the first camera."""
    pose = scene.images[0].world_to_camera
    place: np.ndarray = -0.75 * pose[:3, :3].T @ pose[:3, 3]
    return place


def with_floaters(scene: SfmScene) -> Gaussians:
    places = np.array([floater(scene), floater(scene) + 0.01])
    floaters = Gaussians.from_points(places, scene.colors[:2])
    return Gaussians.concatenate([first_model(scene), floaters])


def one_side(scene: SfmScene) -> StageData:
    """A quarter of the ring of photos: none looks at the others' floaters from behind."""
    images = scene.images[:4]
    order = photo_order.shuffled(range(4), 3)
    return stage_data(scene, images=images, photos=PhotoCache(images), photo_at=order, rois=[BOX])


def mean_loss(trainer: Trainer, steps: int) -> float:
    losses = []
    for _ in range(steps):
        trainer.train_step()
        losses.append(float(trainer.health._new[-1][2]) if trainer.health._new else np.nan)
    return float(np.mean(losses))


def test_training_lowers_the_loss(scene: SfmScene) -> None:
    config = TrainConfig(steps=300)
    start_model = Gaussians.from_points(scene.points, scene.colors)
    trainer = Trainer(start_model, stage_data(scene), config)
    start = mean_loss(trainer, 12)
    assert trainer.run()
    assert mean_loss(trainer, 12) < 0.5 * start


def test_half_of_the_steps_draw_as_pictures_do(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others cull nothing, as other viewers: what only these would draw must cost the loss."""
    seen = []

    def noted(*args: Any, **options: Any) -> RenderOutput:
        seen.append(options.get("limits", NO_LIMITS))
        return rasterize(*args, **options)

    monkeypatch.setattr(trainer_module, "rasterize", noted)
    Trainer(first_model(scene), stage_data(scene), SHORT).run()
    as_pictures = replace(PICTURE_LIMITS, min_transmittance=TRAINING_LIMITS.min_transmittance)
    assert set(seen) == {TRAINING_LIMITS, as_pictures}
    assert abs(seen.count(TRAINING_LIMITS) - len(seen) / 2) <= 1


@pytest.mark.parametrize("period", [2, 3, 5, 84, 91])
def test_every_photo_is_drawn_both_ways(period: int) -> None:
    """For any order of photos and masks, which often has a period."""
    drawn = [
        training_limits(step, linear_light=False) != TRAINING_LIMITS for step in range(12 * period)
    ]
    for first in range(period):
        assert 3 <= sum(drawn[first::period]) <= 9


def data_for(scene: SfmScene, config: TrainConfig) -> StageData:
    """With boxes, where the config needs them."""
    return stage_data(scene, rois=[BOX] if config is MASKED else ())


@pytest.fixture(scope="module")
def never_stopped(scene: SfmScene) -> Callable[[TrainConfig], Gaussians]:
    """The model of a config's training, made once."""

    @functools.cache
    def trained(config: TrainConfig) -> Gaussians:
        whole = Trainer(first_model(scene), data_for(scene, config), config)
        whole.run()
        return whole.gaussians

    return trained


@pytest.mark.parametrize(
    ("config", "stop"),
    [
        *((SHORT, stop) for stop in (1, 10, 29, 33, 59)),
        *((AVERAGED, stop) for stop in (35, 52)),
        *((MASKED, stop) for stop in (24, 25, 26)),
        *((RESTARTED, stop) for stop in (24, 25, 26)),
        *((FADING, stop) for stop in (15, 16, 40)),
    ],
)
def test_resuming_equals_never_stopping(
    scene: SfmScene,
    tmp_path: Path,
    config: TrainConfig,
    stop: int,
    never_stopped: Callable[[TrainConfig], Gaussians],
) -> None:
    data, whole = data_for(scene, config), never_stopped(config)
    half = Trainer(first_model(scene), data, config)
    assert not half.run(Context(should_stop=lambda: half.step >= stop))
    save_checkpoint(tmp_path / "checkpoint.bin", half.state_dict(), "same")
    state = load_checkpoint(tmp_path / "checkpoint.bin", "same")
    rest = Trainer(Gaussians(**state["parameters"]), data, config)
    rest.load_state_dict(state)
    assert rest.step == stop
    assert rest.cpu_seconds == half.cpu_seconds > 0
    assert rest.run()
    assert rest.cpu_seconds > half.cpu_seconds
    assert len(rest.gaussians) == len(whole) > 0
    assert same_bits(rest.gaussians, whole)


def test_a_stage_ends_with_the_mean_of_its_last_models(scene: SfmScene) -> None:
    trainer = Trainer(first_model(scene), stage_data(scene), AVERAGED)
    plain = Trainer(first_model(scene), stage_data(scene), without(AVERAGED, ModelAveraging))
    seen = []
    for _ in range(AVERAGED.steps):
        trainer.train_step()
        plain.train_step()
        if plain.step in (40, 50, 60):
            seen.append(plain.gaussians.detached())
    for name in NAMES:
        mean = torch.stack([getattr(model, name) for model in seen]).mean(dim=0)
        torch.testing.assert_close(getattr(trainer.gaussians, name).detach(), mean)
    assert not same_bits(trainer.gaussians, plain.gaussians)


def test_a_warm_restart_forgets_all_but_colours(scene: SfmScene) -> None:
    plain = without(RESTARTED, WarmRestarts)
    first, other = (
        Trainer(first_model(scene), stage_data(scene), config) for config in (RESTARTED, plain)
    )
    for _ in range(25):
        first.train_step()
        other.train_step()
    assert same_bits(first.gaussians, other.gaussians)
    state, usual = (each.state_dict()["optimizer"] for each in (first, other))
    for key in ("exp_avg", "exp_avg_sq"):
        for name in NAMES:
            assert usual[key][name].any()
            assert bool(state[key][name].any()) == (name == "sh")
    first.train_step()
    other.train_step()
    assert not same_bits(first.gaussians, other.gaussians)


def test_restarts_leave_time_to_settle() -> None:
    restarts = WarmRestarts(count=3)
    found = {}
    for until in (1000, 0, 3000):
        config = TrainConfig(steps=3000, mechanisms=(DensityControl(until=until), restarts))
        found[until] = sorted(restarts.steps(config))
    assert found == {1000: [1000, 1500, 2000], 0: [], 3000: []}
    with pytest.raises(ConfigError, match="warm_restarts needs density_control"):
        TrainConfig(steps=3000, mechanisms=(restarts,))


def test_models_with_other_rows_are_not_averaged(scene: SfmScene) -> None:
    config = AVERAGED.using(ModelAveraging(steps=60))  # from before densification ends
    Trainer(first_model(scene), stage_data(scene), config).run()


def test_roi_stage_adds_gaussians_in_the_box_only(scene: SfmScene) -> None:
    config = PLAIN.using(replace(IN_BOXES, prune_opacity=0.0))
    config = replace(config, lr_means=1e-9, lr_means_final=1e-9)
    trainer = Trainer(first_model(scene), stage_data(scene, rois=[BOX]), config)
    inside_before = int(trainer.gaussians.in_box(BOX).sum())
    outside_before = len(trainer.gaussians) - inside_before
    trainer.run()
    inside = int(trainer.gaussians.in_box(BOX).sum())
    assert inside > inside_before
    # A child of a split may fall just outside; nothing else may appear there.
    assert len(trainer.gaussians) - inside <= outside_before + 0.2 * (inside - inside_before)


def test_budget_limits_the_box(scene: SfmScene) -> None:
    start = first_model(scene)
    limit = int(start.in_box(BOX).sum()) + 5
    config = PLAIN.using(replace(IN_BOXES, budgets=(limit,)))
    trainer = Trainer(start, stage_data(scene, rois=[BOX]), config)
    trainer.run()
    assert int(trainer.gaussians.in_box(BOX).sum()) <= limit + 5


def test_non_contributing_gaussians_are_pruned(scene: SfmScene) -> None:
    start = first_model(scene)
    hidden = start.rows(torch.arange(7))
    hidden.means[:] = torch.tensor([0.0, 0.0, 50.0])
    config = replace(PLAIN, steps=2 * 24 + 2, mechanisms=(IdlePruning(every=24),))
    trainer = Trainer(Gaussians.concatenate([start, hidden]), stage_data(scene), config)
    trainer.run()
    assert not bool((trainer.gaussians.means[:, 2] > 40).any())
    assert len(trainer.gaussians) > 0.5 * len(start)


def test_a_stage_ends_without_floaters(scene: SfmScene) -> None:
    left = {}
    for photos in (0, 3):
        config = RESTING.using(FloaterPruning(min_views=photos)) if photos else RESTING
        trainer = Trainer(with_floaters(scene), one_side(scene), config)
        assert trainer.run()
        distance = np.linalg.norm(trainer.gaussians.means.detach().numpy() - floater(scene), axis=1)
        left[photos] = int((distance < 0.1).sum())
    assert left == {0: 2, 3: 0}


def test_floaters_go_before_the_averaging_and_stopped_there_it_ends_the_same(
    scene: SfmScene,
) -> None:
    """The steps that are averaged make up for the light that they had carried."""
    model, data = with_floaters(scene), one_side(scene)
    config = RESTING.using(ModelAveraging(steps=10), FloaterPruning(min_views=3))
    begins = config.steps - 10
    whole, stopped = (Trainer(model, data, config) for _ in range(2))
    counts: dict[int, int] = {}

    def count() -> bool:
        counts.setdefault(whole.step, len(whole.gaussians))
        return False

    assert whole.run(Context(should_stop=count))
    assert counts[begins] == len(model) > counts[begins + 1] == len(whole.gaussians)
    assert not stopped.run(Context(should_stop=lambda: stopped.step == begins + 5))
    state = stopped.state_dict()
    resumed = Trainer(Gaussians(**state["parameters"]), data, config)
    resumed.load_state_dict(state)
    assert resumed.run()
    assert same_bits(resumed.gaussians, whole.gaussians)


def test_stopped_among_the_floaters_it_goes_on_to_the_same_end(scene: SfmScene) -> None:
    model, data = with_floaters(scene), one_side(scene)
    config = RESTING.using(FloaterPruning(min_views=3))
    whole, stopped = (Trainer(model, data, config) for _ in range(2))
    whole.run()
    assert not stopped.run(Context(should_stop=lambda: stopped.step == config.steps))
    assert len(whole.gaussians) < len(stopped.gaussians) == len(model)
    state = stopped.state_dict()
    resumed = Trainer(Gaussians(**state["parameters"]), data, config)
    resumed.load_state_dict(state)
    assert resumed.run()
    assert same_bits(resumed.gaussians, whole.gaussians)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_the_stage_decides_as_what_it_draws(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch, target: Target
) -> None:
    """In every step, through densification, averaging and a resumption."""
    drawn = set()

    def noted(*args: Any, **options: Any) -> RenderOutput:
        limits = options["limits"]
        drawn.add((options["antialiased"], options["linear_light"], limits.min_transmittance))
        return rasterize(*args, **options)

    monkeypatch.setattr("roigs_engine.training.trainer.rasterize", noted)
    config = replace(SHORT.using(ModelAveraging(steps=10)), made_for=target.name)
    start = replace(first_model(scene), target=VIEWERS if target == PLAIN_3DGS else PLAIN_3DGS)
    trainer = Trainer(start, stage_data(scene), config)
    resumed = Trainer(start, stage_data(scene), config)
    trainer.train_step()
    resumed.load_state_dict(trainer.state_dict())
    for each in (trainer, resumed):
        assert each.run()
        assert len(each.gaussians) != len(start)
        assert each.gaussians.target == target
    least = 1e-3 / (12.92 if target.linear_light else 1)
    assert drawn == {(target.antialiased, target.linear_light, least)}
