"""The presets: complete settings of a run by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..errors import ConfigError
from ..selection.config import SelectionConfig
from ..training.config import TrainConfig, with_steps
from .config import RunConfig

REFINE_SHARE = 0.2  # of the box stage's steps, for the joint refinement (notebook/paper.md)

# Of both stages of the joint recipe.
SHARED: dict[str, Any] = {
    "reset_every": 0,  # a short stage does not recover from a reset: haze would stay
    "opacity_decay": 0.025,
    "faint_growth": 0.05,
    "restarts": 3,
    "antialiased": True,
}


def paper_recipe() -> RunConfig:
    """Sections II-B and III-A of the paper; docs/method.md lists what the paper leaves open."""
    return RunConfig(
        preset="paper",
        strategy="independent",
        selection=SelectionConfig(method="gp9"),
        kept_share=0.5,
        scene=TrainConfig(steps=20_000, densify_until=10_000),
        roi=TrainConfig(
            steps=30_000,
            sh_start=3,
            densify_from=0,
            densify_until=15_000,
            densify_in_boxes=True,
            reset_every=0,
            contribution_every=1000,
        ),
        baseline_densify=0.3,
        whole_schedule=True,
    )


def joint_recipe(
    name: str,
    scene_steps: int,
    roi_steps: int,
    scene_threshold: float = TrainConfig.grad_threshold,
) -> RunConfig:
    """The joint recipe: a short Scene-GS, then one stage that densifies in the boxes only.

    notebook/README.md has the measurements behind the values that differ from 3DGS and the paper.
    """
    # The Scene-GS's position learning rate decays as the baseline's does over its first steps. The
    # box stage starts at the full one again: its new Gaussians must move far.
    middle = 1.6e-4 * (1.6e-6 / 1.6e-4) ** (scene_steps / (scene_steps + roi_steps))
    return RunConfig(
        preset=name,
        strategy="joint",
        selection=SelectionConfig(method="coverage"),
        kept_share=1.0,
        scene_scale=0.5,
        scene=TrainConfig(
            steps=scene_steps,
            densify_until=scene_steps * 5 // 8,
            grad_threshold=scene_threshold,
            lr_means_final=middle,
            backdrop_cells=16,
            **SHARED,
        ),
        roi=TrainConfig(
            steps=roi_steps,
            sh_start=3,
            # 3DGS's learning rates suit six times as many steps; SH is learned last.
            lr_shN=1.5e-3,
            lr_shN_spacing=25.0,
            lr_shN_measured=True,
            lr_scales=0.01,
            densify_from=0,
            densify_until=roi_steps // 3,
            small_until=roi_steps // 3,  # what densification adds is coarse at first
            whole_small_until=roi_steps * 2 // 3,
            densify_in_boxes=True,
            grad_threshold=6e-5,
            # Far away 4 x 3DGS's; at the boxes' sides 3DGS's: people look at both from near.
            outside_grad_threshold=8e-4,
            near_grad_threshold=2e-4,
            box_budget=32.0,
            full_every=3,
            outside_spared_spread=45.0,
            outside_rate=2.0,  # 3 would make up for the fewer steps, but loses where SH learn fast
            view_weighting=1.5,
            min_views=4,
            average_steps=roi_steps // 10,
            **SHARED,
        ),
        roi_order="shuffled",
        selected_share=0.2,
    )


PRESETS: dict[str, Callable[[], RunConfig]] = {
    "paper": paper_recipe,
    # Higher threshold: in 4,000 steps, the Scene-GS would get more Gaussians than it needs.
    "standard": lambda: joint_recipe("standard", 4000, 4500, scene_threshold=3e-4),
    "draft": lambda: joint_recipe("draft", 2000, 3000),
}


def preset(name: str) -> RunConfig:
    """The preset of that name.

    Raises:
        ConfigError: the name is unknown.
    """
    if name not in PRESETS:
        raise ConfigError(f"There is no preset '{name}'.", f"Use one of {', '.join(PRESETS)}.")
    return PRESETS[name]()


def in_strategy(config: RunConfig, strategy: str) -> RunConfig:
    """The config for another strategy: the paper's recipe, or the preset's joint recipe.

    Steps, SH degree, anti-aliasing, baselines, test photos, seed and number of selected photos stay
    the same. The intervals of the paper's recipe do not shrink with the steps (`with_steps`).
    """
    label = f"{config.preset}, {strategy}"
    if strategy == "joint":
        named = PRESETS.get(config.preset.partition(",")[0])
        threshold = named().scene.grad_threshold if named else TrainConfig.grad_threshold
        other = joint_recipe(label, config.scene.steps, config.roi.steps, threshold)
    else:
        other = paper_recipe()
        other = replace(
            other,
            preset=label,
            refine_share=REFINE_SHARE,
            scene=with_steps(other.scene, config.scene.steps),
            roi=with_steps(other.roi, config.roi.steps),
        )
    now = config.roi
    kept: dict[str, Any] = {"sh_degree": now.sh_degree, "antialiased": now.antialiased}
    return replace(
        other,
        scene=replace(other.scene, **kept),
        roi=replace(other.roi, **kept),
        selection=replace(other.selection, seed=config.seed, count=config.selection.count),
        baseline_densify=config.baseline_densify,
        whole_schedule=False,
        test_every=config.test_every,
        evaluate_on=config.evaluate_on,
        seed=config.seed,
        blocks=config.blocks,
        groups=config.groups if strategy == "joint" else (),
    )
