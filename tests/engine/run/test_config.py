"""Presets and settings: the paper's numbers, ranges, scaling, fair baselines."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roigs_engine.errors import ConfigError, RunFolderError
from roigs_engine.run import stage_configs
from roigs_engine.run.config import RunConfig
from roigs_engine.run.manifest import manifest_difference, read_manifest
from roigs_engine.run.presets import PRESETS, in_strategy, preset
from roigs_engine.training.config import TrainConfig, with_steps
from roigs_engine.training.mechanisms.background_points import BackgroundPoints
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.floater_pruning import FloaterPruning
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.mechanisms.measured_sh_rate import MeasuredShRate
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay
from tests.engine.settings import adjusted, without


def test_paper_preset_has_the_papers_numbers() -> None:
    config = preset("paper")
    assert (config.scene.steps, config.roi.steps) == (20_000, 30_000)
    assert config.strategy == "independent"
    assert config.selection.method == "gp9"
    assert [config.selection.resolved_count(n) for n in (314, 41, 1)] == [150, 20, 1]
    assert config.kept_share == 0.5
    assert config.roi_order == "ordered"
    assert config.roi_init == "scene"
    boxes = BoxDensityControl(start=0, until=15_000, reset_every=0)
    assert config.roi.mechanisms == (boxes, IdlePruning(every=1000))
    assert boxes.box_sizes and not boxes.outside_threshold and not boxes.budget
    assert config.scene.mechanisms == (DensityControl(until=10_000),)
    assert config.roi.degree(0) == config.roi.sh_degree == 3


def test_training_defaults_are_those_of_3dgs() -> None:
    config = TrainConfig(steps=30_000)
    assert config.position_learning_rate(0) == pytest.approx(1.6e-4)
    assert config.position_learning_rate(30_000) == pytest.approx(1.6e-6)
    assert config.position_learning_rate(15_000) == pytest.approx(1.6e-5)
    assert config.ssim_weight == 0.2
    density = DensityControl()
    assert (density.start, density.every, density.until) == (500, 100, 15_000)
    assert (density.grad_threshold, density.split_fraction) == (2e-4, 0.01)
    assert (density.prune_opacity, density.reset_every) == (0.005, 3000)


@given(st.integers(0, 20_000))
def test_rates_fall_and_degrees_rise_with_the_steps(step: int) -> None:
    config = TrainConfig(steps=10_000)
    assert config.position_learning_rate(step + 1) <= config.position_learning_rate(step)
    assert config.position_learning_rate(step) >= config.lr_means_final * (1 - 1e-12)
    assert config.degree(step) == min(3, step // 1000)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_complete_and_fair(name: str) -> None:
    config = preset(name)
    assert config.preset == name
    assert config.total_steps == config.scene.steps + config.roi.steps
    total = config.total_steps
    densify = {"paper": total * 15 // 50}.get(name, total // 2)  # 15,000 of 50,000; 3DGS: half
    plain = TrainConfig(steps=total, mechanisms=(DensityControl(until=densify),))
    assert stage_configs.baseline(config) == plain
    assert config.roi.of(BoxDensityControl).box_sizes
    assert config.roi.position_learning_rate(config.roi.steps) == pytest.approx(1.6e-6)


@pytest.mark.parametrize("name", ["standard", "draft"])
def test_short_presets_break_the_decay_off_and_begin_anew(name: str) -> None:
    config, whole = preset(name), stage_configs.baseline(preset(name))
    steps = config.scene.steps
    assert config.scene.position_learning_rate(steps) == pytest.approx(
        whole.position_learning_rate(steps)
    )
    assert config.roi.position_learning_rate(0) == pytest.approx(whole.position_learning_rate(0))


@pytest.mark.parametrize("name", sorted(PRESETS))
@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_the_other_strategy_keeps_steps_tests_and_seed(name: str, strategy: str) -> None:
    config = replace(preset(name), test_every=5, seed=7)
    config = replace(config, selection=replace(config.selection, count=9))
    config = replace(config, scene=replace(config.scene, sh_degree=1))
    config = replace(config, roi=replace(config.roi, sh_degree=1))
    other = in_strategy(config, strategy)
    assert other.selection.count == 9
    assert (
        other.scene.sh_degree
        == other.roi.sh_degree
        == stage_configs.refine_stage(other).sh_degree
        == 1
    )
    assert other.strategy == strategy
    assert (other.scene.steps, other.roi.steps) == (config.scene.steps, config.roi.steps)
    assert (other.test_every, other.seed) == (5, 7)
    assert other.roi.get(BoxDensityControl) is not None
    stages = (other.scene, other.roi, stage_configs.refine_stage(other))
    assert {stage.made_for for stage in stages} == {config.roi.made_for}


@pytest.mark.parametrize("name", ["standard", "draft"])
def test_there_and_back_is_the_preset(name: str) -> None:
    config = preset(name)
    back = in_strategy(in_strategy(config, "independent"), "joint")
    assert replace(back, preset=name) == config


def test_settings_are_frozen_and_plain_json() -> None:
    config = preset("draft")
    with pytest.raises(FrozenInstanceError):
        config.seed = 1  # type: ignore[misc]
    assert json.loads(json.dumps(config.to_dict()))["scene"]["steps"] == config.scene.steps


@given(st.floats(0.001, 20))
def test_scaling_keeps_the_share_of_densifying_steps(factor: float) -> None:
    config = preset("paper").scaled(factor)
    for stage, before in ((config.scene, 20_000), (config.roi, 30_000)):
        assert stage.steps == max(1, round(before * factor))
        assert stage.of(DensityControl).until == pytest.approx(stage.steps / 2, abs=1)


def test_with_steps_changes_the_length_only() -> None:
    whole = preset("paper").roi
    short = replace(adjusted(whole, DensityControl, until=1500), steps=3000)
    assert with_steps(whole, 3000) == short


def events(config: TrainConfig) -> dict[str, int]:
    """Number of densifications, SH degrees, opacity resets, and so on in the schedule."""
    due, density = range(1, config.steps + 1), config.of(DensityControl)
    idle = config.get(IdlePruning)
    return {
        "densifications": sum(map(density.grows, due)),
        "resets": sum(map(density.resets, due)),
        "windows": config.steps // idle.every if idle else 0,
        "degree": config.degree(config.steps),
        "raises": len({config.degree(step) for step in due}),
    }


@pytest.mark.parametrize("factor", [0.01, 0.05, 0.1, 0.5, 2])
@pytest.mark.parametrize("stage", ["scene", "roi", "baseline"])
def test_the_papers_schedule_shrinks_as_a_whole(stage: str, factor: float) -> None:
    def of(config: RunConfig) -> TrainConfig:
        return stage_configs.baseline(config) if stage == "baseline" else getattr(config, stage)

    full, small = of(preset("paper")), of(preset("paper").scaled(factor))
    assert events(small) == events(full)
    assert small.steps == full.steps * factor
    assert small.of(DensityControl).until == full.of(DensityControl).until * factor
    counts = {"scene": (95, 3), "roi": (149, 0), "baseline": (145, 4)}
    assert (events(full)["densifications"], events(full)["resets"]) == counts[stage]


@given(st.floats(0.0001, 20))
def test_an_interval_keeps_a_step_and_what_is_off_stays_off(factor: float) -> None:
    config = preset("paper").scaled(factor)
    scene, roi = (stage.of(DensityControl) for stage in (config.scene, config.roi))
    assert min(scene.every, config.scene.sh_every, scene.reset_every) >= 1
    assert (roi.reset_every, roi.start) == (0, 0)
    assert config.roi.of(IdlePruning).every >= 1


@pytest.mark.parametrize("name", ["standard", "draft"])
def test_intervals_of_joint_presets_do_not_shrink(name: str) -> None:
    config, short = preset(name), preset(name).scaled(0.1)
    for before, now in ((config.scene, short.scene), (config.roi, short.roi)):
        assert now.sh_every == before.sh_every
        densities = (stage.of(DensityControl) for stage in (before, now))
        first, second = ((d.start, d.every, d.reset_every) for d in densities)
        assert first == second
    independent = in_strategy(config, "independent")
    assert not independent.whole_schedule and independent.scene.of(DensityControl).every == 100
    assert independent.baseline_densify == 0.5


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan")])
def test_a_factor_that_is_not_positive_is_refused(factor: float) -> None:
    with pytest.raises(ConfigError, match="factor"):
        preset("draft").scaled(factor)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"strategy": "both"}, "strategy"),
        ({"roi_init": "nothing"}, "roi_init"),
        ({"roi_order": "backwards"}, "roi_order"),
        ({"kept_share": 1.5}, "kept_share"),
        ({"selected_share": -0.1}, "selected_share"),
        ({"scene_scale": 0.0}, "scene_scale"),
        ({"kept_share": float("nan")}, "kept_share"),
        ({"strategy": "joint", "roi_init": "box"}, "box"),
        ({"scene": preset("draft").scene.using(FloaterPruning())}, "floater_pruning"),
    ],
)
def test_values_out_of_range_are_refused_by_name(change: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        replace(preset("draft"), **change)


def test_an_unknown_preset_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="draft") as caught:
        preset("fast")
    assert "fast" in caught.value.message


@pytest.mark.parametrize(
    "change",
    [{"roi_init": "points"}, {"roi_init": "box"}, {"roi_order": "shuffled"}, {"kept_share": 1.0}],
)
def test_the_papers_ablations_are_settings(change: dict[str, object]) -> None:
    assert isinstance(replace(preset("paper"), **change), RunConfig)


@pytest.mark.parametrize("method", ["static", "gp6"])
def test_the_papers_selection_ablations_are_settings(method: str) -> None:
    config = preset("paper")
    changed = replace(config, selection=replace(config.selection, method=method))
    assert changed.selection.resolved_count(1000) == 150


def test_both_stages_are_made_for_the_same() -> None:
    assert preset("paper").roi.made_for == "plain"
    config = preset("draft")
    assert config.scene.made_for == config.roi.made_for == "viewers"
    with pytest.raises(ConfigError, match="made for plain, the box stage for viewers"):
        replace(config, scene=replace(config.scene, made_for="plain"))


def difference(before: RunConfig, now: RunConfig) -> str:
    """The difference between the manifests of two runs."""
    records = ({"config": json.loads(json.dumps(each.to_dict()))} for each in (before, now))
    return manifest_difference(*records)


def test_manifests_tell_of_targets() -> None:
    draft = preset("draft")
    stages = {"scene": draft.scene, "roi": draft.roi}
    plain = replace(draft, **{n: replace(s, made_for="plain") for n, s in stages.items()})
    told = difference(plain, draft)
    assert told == "it was made for plain, now viewers (--made-for)"


def test_manifests_tell_of_mechanisms() -> None:
    draft = preset("draft")
    less = replace(draft, roi=without(draft.roi, MeasuredShRate))
    assert difference(less, draft) == "roi.measured_sh_rate was off, now on"
    assert difference(draft, less) == "roi.measured_sh_rate was on, now off"
    other = replace(draft, scene=draft.scene.using(OpacityDecay(share=0.1)))
    assert difference(draft, other) == "scene.opacity_decay.share was 0.025, now 0.1"


def test_what_the_plan_decides_is_no_setting() -> None:
    draft = preset("draft")
    planned = adjusted(draft.roi, BoxDensityControl, budgets=(7,))
    assert planned.to_dict() == draft.roi.to_dict()
    assert planned.to_dict(planned=True) != draft.roi.to_dict(planned=True)


def test_parts_of_a_scene_have_no_background_points() -> None:
    scene = preset("draft").scene
    assert scene.get(BackgroundPoints) is not None
    assert stage_configs.surroundings_stage(scene, 0.5).get(BackgroundPoints) is None


@pytest.mark.parametrize("value", [5, [5], "x", {"x": 5}, [{"name": []}], None])
@pytest.mark.parametrize("key", ["sizes", "rois", "groups", "contents", "masks", "object_masks"])
def test_a_damaged_manifest_differs_in_words(key: str, value: object) -> None:
    good = {"sizes": [[9, 9]], "rois": [{"name": "a"}], "masks": {"a": "b"}}
    assert manifest_difference({**good, key: value}, good) or value == good.get(key)


def test_what_is_no_manifest_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"is not a manifest.* Delete it"):
        read_manifest(path)
