"""The presets: complete settings of a run by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..errors import ConfigError
from ..formats.targets import VIEWERS
from ..selection.config import SelectionConfig
from ..training.config import Mechanism, TrainConfig, with_steps
from ..training.mechanisms.background_points import BackgroundPoints
from ..training.mechanisms.box_density_control import BoxDensityControl
from ..training.mechanisms.density_control import DensityControl
from ..training.mechanisms.floater_pruning import FloaterPruning
from ..training.mechanisms.idle_pruning import IdlePruning
from ..training.mechanisms.importance_pruning import ImportancePruning
from ..training.mechanisms.masked_steps import MaskedSteps
from ..training.mechanisms.measured_sh_rate import MeasuredShRate
from ..training.mechanisms.model_averaging import ModelAveraging
from ..training.mechanisms.opacity_decay import OpacityDecay
from ..training.mechanisms.surroundings_rate import SurroundingsRate
from ..training.mechanisms.warm_restarts import WarmRestarts
from .config import RunConfig

REFINE_SHARE = 0.2  # of the box stage's steps, for the joint refinement (notebook/paper.md)
# Settings that `in_strategy` keeps.
KEPT = ("baseline_densify", "test_every", "evaluate_on", "seed", "blocks")


def paper_recipe() -> RunConfig:
    """The paper's recipe (sections II-B and III-A); docs/method.md lists what it leaves open."""
    return RunConfig(
        preset="paper",
        strategy="independent",
        selection=SelectionConfig(method="gp9"),
        kept_share=0.5,
        scene=TrainConfig(steps=20_000, mechanisms=(DensityControl(until=10_000),)),
        roi=TrainConfig(
            steps=30_000,
            sh_start=3,
            mechanisms=(
                BoxDensityControl(start=0, until=15_000, reset_every=0),
                IdlePruning(every=1000),
            ),
        ),
        baseline_densify=0.3,
        whole_schedule=True,
    )


def joint_recipe(
    name: str,
    scene_steps: int,
    roi_steps: int,
    scene_threshold: float = DensityControl.grad_threshold,
) -> RunConfig:
    """The joint recipe: a short Scene-GS, then one stage that densifies in the boxes only.

    notebook/README.md has the measurements behind the values that differ from 3DGS and the paper.
    """
    # The Scene-GS's position learning rate decays like the baseline's over its first steps. The box
    # stage starts at the full rate again, because its new Gaussians must move far.
    middle = 1.6e-4 * (1.6e-6 / 1.6e-4) ** (scene_steps / (scene_steps + roi_steps))
    return RunConfig(
        preset=name,
        strategy="joint",
        selection=SelectionConfig(method="coverage"),
        kept_share=1.0,
        scene_scale=0.5,
        scene=TrainConfig(
            steps=scene_steps,
            lr_means_final=middle,
            made_for=VIEWERS.name,
            mechanisms=_scene_mechanisms(scene_steps, scene_threshold),
        ),
        roi=TrainConfig(
            steps=roi_steps,
            sh_start=3,
            # 3DGS's learning rates suit six times as many steps; SH is learned last.
            lr_shN=1.5e-3,
            lr_scales=0.01,
            made_for=VIEWERS.name,
            mechanisms=_box_mechanisms(roi_steps),
        ),
        roi_order="shuffled",
        selected_share=0.2,
    )


def _scene_mechanisms(steps: int, threshold: float) -> tuple[Mechanism, ...]:
    """The mechanisms of the joint recipe's Scene-GS."""
    return (
        BackgroundPoints(cells=16),
        # A short stage does not recover from an opacity reset: haze would stay.
        DensityControl(until=steps * 5 // 8, grad_threshold=threshold, reset_every=0),
        WarmRestarts(count=3),
        OpacityDecay(share=0.025),
        ImportancePruning(growth=0.05),
    )


def _box_mechanisms(steps: int) -> tuple[Mechanism, ...]:
    """The mechanisms of the joint recipe's box stage."""
    return (
        MaskedSteps(reinvested=0.5, view_weighting=1.5),
        MeasuredShRate(),
        # A factor of 3 would compensate for the fewer steps, but is worse if SH learn fast.
        SurroundingsRate(factor=2.0),
        BoxDensityControl(
            start=0,
            until=steps // 3,
            grad_threshold=6e-5,
            outside_threshold=8e-4,  # 4 x the threshold of 3DGS
            budget=32.0,
            reset_every=0,
        ),
        WarmRestarts(count=3),
        ModelAveraging(steps=steps // 10),
        OpacityDecay(share=0.025),
        ImportancePruning(growth=0.05),
        FloaterPruning(min_views=4),
    )


PRESETS: dict[str, Callable[[], RunConfig]] = {
    "paper": paper_recipe,
    # A higher threshold: in 4,000 steps, the Scene-GS would get more Gaussians than it needs.
    "standard": lambda: joint_recipe("standard", 4000, 4500, scene_threshold=3e-4),
    "draft": lambda: joint_recipe("draft", 2000, 3000),
}


def preset(name: str) -> RunConfig:
    """The preset of that name; ConfigError if there is none."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset '{name}'.", f"Use one of {', '.join(PRESETS)}.")
    return PRESETS[name]()


def in_strategy(config: RunConfig, strategy: str) -> RunConfig:
    """Convert a config to another strategy: the paper's recipe, or the preset's joint recipe.

    Steps, SH degree, target, baselines, test photos, seed and number of selected photos stay
    the same. The intervals of the paper's recipe do not shrink with the steps (`with_steps`).
    """
    label = f"{config.preset}, {strategy}"
    if strategy == "joint":
        named = PRESETS.get(config.preset.partition(",")[0])
        own = named().scene.get(DensityControl) if named else None
        threshold = (own or DensityControl()).grad_threshold
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
    kept: dict[str, Any] = {name: getattr(config, name) for name in KEPT}
    stages: dict[str, Any] = {
        "sh_degree": config.roi.sh_degree,
        "made_for": config.roi.made_for,
    }
    return replace(
        other,
        scene=replace(other.scene, **stages),
        roi=replace(other.roi, **stages),
        selection=replace(other.selection, seed=config.seed, count=config.selection.count),
        whole_schedule=False,
        groups=config.groups if strategy == "joint" else (),
        **kept,
    )
