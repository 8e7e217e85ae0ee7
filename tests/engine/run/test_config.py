"""Presets and settings: the paper's numbers, ranges, scaling, fair baselines."""

from __future__ import annotations

import copy
import json
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roigs_engine.errors import ConfigError
from roigs_engine.run import stage_configs
from roigs_engine.run.config import RunConfig
from roigs_engine.run.manifest import manifest_difference
from roigs_engine.run.presets import PRESETS, in_strategy, preset
from roigs_engine.training.config import INTERVALS, TrainConfig, with_steps


def test_paper_preset_has_the_papers_numbers() -> None:
    config = preset("paper")
    assert (config.scene.steps, config.roi.steps) == (20_000, 30_000)
    assert config.strategy == "independent"
    assert config.selection.method == "gp9"
    assert [config.selection.resolved_count(n) for n in (314, 41, 1)] == [150, 20, 1]
    assert config.kept_share == 0.5
    assert config.roi_order == "ordered"
    assert config.roi_init == "scene"
    assert config.roi.densify_in_boxes and config.roi.densify_until == 15_000
    assert config.roi.reset_every == 0 and config.scene.reset_every == 3000
    assert config.roi.contribution_every > 0
    assert config.roi.degree(0) == config.roi.sh_degree == 3


def test_training_defaults_are_those_of_3dgs() -> None:
    config = TrainConfig(steps=30_000)
    assert config.position_learning_rate(0) == pytest.approx(1.6e-4)
    assert config.position_learning_rate(30_000) == pytest.approx(1.6e-6)
    assert config.position_learning_rate(15_000) == pytest.approx(1.6e-5)
    assert (config.densify_from, config.densify_every, config.densify_until) == (500, 100, 15_000)
    assert (config.grad_threshold, config.split_fraction) == (2e-4, 0.01)
    assert (config.prune_opacity, config.reset_every, config.ssim_weight) == (0.005, 3000, 0.2)


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
    assert stage_configs.baseline(config) == TrainConfig(steps=total, densify_until=densify)
    assert config.roi.densify_in_boxes
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
    assert other.roi.densify_in_boxes
    stages = (other.scene, other.roi, stage_configs.refine_stage(other))
    assert {stage.antialiased for stage in stages} == {config.roi.antialiased}


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
        assert stage.densify_until == pytest.approx(stage.steps / 2, abs=1)


def test_with_steps_changes_the_length_only() -> None:
    short = with_steps(preset("paper").roi, 3000)
    assert short == replace(preset("paper").roi, steps=3000, densify_until=1500)


def events(config: TrainConfig) -> dict[str, int]:
    """How often the schedule densifies, raises the SH degree, resets opacities, and so on."""
    due = range(1, config.steps + 1)
    densifying = [step for step in due if config.densify_from <= step < config.densify_until]
    return {
        "densifications": sum(step % config.densify_every == 0 for step in densifying),
        "resets": sum(step % config.reset_every == 0 for step in densifying)
        if config.reset_every
        else 0,
        "windows": config.steps // config.contribution_every if config.contribution_every else 0,
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
    assert small.densify_until == full.densify_until * factor
    counts = {"scene": (95, 3), "roi": (149, 0), "baseline": (145, 4)}
    assert (events(full)["densifications"], events(full)["resets"]) == counts[stage]


@given(st.floats(0.0001, 20))
def test_an_interval_keeps_a_step_and_what_is_off_stays_off(factor: float) -> None:
    config = preset("paper").scaled(factor)
    assert min(config.scene.densify_every, config.scene.sh_every, config.scene.reset_every) >= 1
    assert (config.roi.reset_every, config.roi.densify_from) == (0, 0)
    assert (config.scene.contribution_every, config.roi.contribution_every > 0) == (0, True)


@pytest.mark.parametrize("name", ["standard", "draft"])
def test_intervals_of_joint_presets_do_not_shrink(name: str) -> None:
    config, short = preset(name), preset(name).scaled(0.1)
    for before, now in ((config.scene, short.scene), (config.roi, short.roi)):
        assert {getattr(now, n) == getattr(before, n) for n in INTERVALS} == {True}
    independent = in_strategy(config, "independent")
    assert not independent.whole_schedule and independent.scene.densify_every == 100
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
        ({"scene": replace(preset("draft").scene, min_views=4)}, "min_views"),
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


def test_antialiasing_is_of_both_stages_or_of_none() -> None:
    assert not preset("paper").roi.antialiased
    config = preset("draft")
    assert config.scene.antialiased and config.roi.antialiased
    with pytest.raises(ConfigError, match="anti-aliasing"):
        replace(config, scene=replace(config.scene, antialiased=False))


def test_manifests_from_before_antialiasing_are_those_without_it() -> None:
    paper, draft = preset("paper").to_dict(), preset("draft").to_dict()
    assert "antialiased" not in paper["scene"] and "antialiased" not in paper["roi"]
    assert draft["scene"]["antialiased"] and draft["roi"]["antialiased"]
    old = copy.deepcopy(draft)
    del old["scene"]["antialiased"], old["roi"]["antialiased"]
    told = manifest_difference({"config": old}, {"config": draft})
    assert told == "anti-aliasing was off, now on (--antialiased, --no-antialiased)"


def test_manifests_from_before_faint_gaussians_were_removed_say_so() -> None:
    paper, draft = preset("paper").to_dict(), preset("draft").to_dict()
    assert "faint_growth" not in paper["scene"] and "faint_growth" not in paper["roi"]
    old = copy.deepcopy(draft)
    del old["scene"]["faint_growth"], old["roi"]["faint_growth"]
    told = manifest_difference({"config": old}, {"config": draft})
    assert told == "faint Gaussians were kept, now they are removed"


@pytest.mark.parametrize(
    ("stage", "field", "told"),
    [
        ("scene", "backdrop_cells", "places without points were left empty, now they are filled"),
        (
            *("roi", "near_grad_threshold"),
            "near the boxes, Gaussians were densified as elsewhere, now more than elsewhere",
        ),
        ("scene", "opacity_decay", "opacity decay was off, now on"),
        (
            *("roi", "outside_spared_spread"),
            "outside the boxes, opacities decayed as inside, now less with photos from one side",
        ),
        (
            *("roi", "outside_rate"),
            "Gaussians outside the boxes had the learning rates of the others, now their own",
        ),
    ],
)
def test_manifests_from_before_a_setting_say_so(stage: str, field: str, told: str) -> None:
    draft = preset("draft")
    assert field not in in_strategy(draft, "independent").to_dict()[stage]
    old, now = draft.to_dict(), draft.to_dict()
    del old[stage][field]
    assert manifest_difference({"config": old}, {"config": now}) == told


def test_parts_of_a_scene_have_no_backdrop() -> None:
    scene = preset("draft").scene
    assert scene.backdrop_cells > 0
    assert stage_configs.surroundings_stage(scene, 0.5).backdrop_cells == 0
