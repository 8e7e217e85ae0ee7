"""The presets that people start from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..errors import ConfigError
from ..selection.config import SelectionConfig
from ..training.config import TrainConfig, with_steps
from .config import RunConfig

REFINE_SHARE = 0.2  # of the ROI stage, where a composition is refined (docs/results.md)


def paper_recipe() -> RunConfig:
    """Section II-B and III-A of the paper, gaps filled as docs/method.md says."""
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
    )


def joint_recipe(
    name: str,
    scene_steps: int,
    roi_steps: int,
    scene_threshold: float = TrainConfig.grad_threshold,
) -> RunConfig:
    """The joint recipe: a short Scene-GS, then one stage that densifies in the boxes only.

    What differs from 3DGS and the paper is measured in docs/results.md.
    """
    # The scene's position rates decay as the baseline's do over its first steps: it is not done
    # at its end. The ROI stage begins at the full rate again, for its new Gaussians must travel.
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
            reset_every=0,  # so short a stage does not recover: a haze would stay
        ),
        roi=TrainConfig(
            steps=roi_steps,
            sh_start=3,
            # 3DGS's rates suit six times as many steps; view dependence is last to come.
            lr_shN=1.5e-3,
            lr_shN_spacing=25.0,
            lr_scales=0.01,
            densify_from=0,
            densify_until=roi_steps // 3,
            densify_in_boxes=True,
            grad_threshold=8e-5,
            box_budget=2.2,
            full_every=4,
            view_weighting=1.0,
            reset_every=0,
            min_views=4,
            average_steps=roi_steps // 10,
        ),
        roi_order="shuffled",
        selected_share=0.2,
    )


PRESETS: dict[str, Callable[[], RunConfig]] = {
    "paper": paper_recipe,
    # Densified for so long, the Scene-GS would come to more Gaussians than the boxes need around.
    "standard": lambda: joint_recipe("standard", 6000, 9000, scene_threshold=3e-4),
    "draft": lambda: joint_recipe("draft", 2000, 3000),
}


def preset(name: str) -> RunConfig:
    """The preset of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in PRESETS:
        raise ConfigError(f"There is no preset '{name}'.", f"Use one of {', '.join(PRESETS)}.")
    return PRESETS[name]()


def in_strategy(config: RunConfig, strategy: str) -> RunConfig:
    """The same steps, SH degree, test photos, seed and number of photos in another strategy.

    That is the paper's own, or the preset's recipe for all boxes together.
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
    return replace(
        other,
        scene=replace(other.scene, sh_degree=config.scene.sh_degree),
        roi=replace(other.roi, sh_degree=config.roi.sh_degree),
        selection=replace(other.selection, seed=config.seed, count=config.selection.count),
        test_every=config.test_every,
        seed=config.seed,
    )
