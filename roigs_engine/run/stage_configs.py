"""Settings of each stage, derived from the run's: lists of mechanisms."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from ..formats.targets import PLAIN
from ..training.config import TrainConfig, miniature, with_steps
from ..training.mechanisms.box_density_control import BoxDensityControl
from ..training.mechanisms.cutout_steps import CutoutSteps
from ..training.mechanisms.density_control import DensityControl
from ..training.mechanisms.floater_pruning import FloaterPruning
from ..training.mechanisms.idle_pruning import IdlePruning
from ..training.mechanisms.importance_pruning import ImportancePruning
from ..training.mechanisms.masked_steps import MaskedSteps
from ..training.mechanisms.measured_sh_rate import MeasuredShRate
from ..training.mechanisms.model_averaging import ModelAveraging
from ..training.mechanisms.opacity_decay import OpacityDecay
from ..training.mechanisms.surface_losses import SurfaceLosses
from ..training.mechanisms.warm_restarts import WarmRestarts
from .config import RunConfig
from .presets import in_strategy, joint_recipe

# Steps on whole photos for surroundings, as a share of the steps of a stage with masks. There, a
# third of the steps use whole photos. The masks of the other steps show much of the area behind the
# boxes, which may be in another block.
WHOLE_SHARE = 0.6
CUTOUT_SHARE = 0.6  # steps of the cutout stage, as a share of the box stage's
SURFACE_SHARE = 0.15  # the same for the surface stage
SURFACE_RATE = 0.3  # its initial position learning rate, as a share of the box stage's


@dataclass(frozen=True, kw_only=True)
class TunedBaseline:
    """Settings of the two stages of a tuned baseline; the second uses full-size photos."""

    coarse: TrainConfig
    scale: float  # factor on the size of the first stage's photos
    fine: TrainConfig


def baseline(config: RunConfig) -> TrainConfig:
    """Settings of Full Scene and Full Object: 3DGS over the steps of both stages.

    The intervals are the Scene-GS's: in a miniature of the paper's schedule, these are scaled.
    """
    own = config.scene.get(DensityControl) or DensityControl()
    density = DensityControl(
        start=own.start,
        until=_densify_steps(config),
        every=own.every,
        grad_threshold=DensityControl.grad_threshold,
        reset_every=own.reset_every or DensityControl().reset_every,
    )
    return replace(
        config.scene,
        steps=config.total_steps,
        lr_means_final=TrainConfig.lr_means_final,
        made_for=PLAIN.name,
        mechanisms=(density,),
    )


def tuned_baseline(config: RunConfig) -> TunedBaseline:
    """Settings of the tuned Full Scene and Full Object: ours, minus those that need boxes.

    These are the joint recipe's, without masks, weights, budgets and the lower threshold. In total,
    as many steps densify as in the baseline. The last stage densifies for at least a third of its
    steps, like the joint stage.
    """
    ours = config if config.strategy == "joint" else in_strategy(config, "joint")
    scene, box = ours.scene.of(DensityControl), ours.roi.of(DensityControl)
    until = max(_densify_steps(config) - scene.until, ours.roi.steps // 3)
    density = DensityControl(
        start=box.start,
        until=min(until, ours.roi.steps),
        every=box.every,
        grad_threshold=DensityControl.grad_threshold,
        reset_every=box.reset_every,
    )
    fine = _without_boxes(ours.roi, density)
    return TunedBaseline(coarse=ours.scene, scale=ours.scene_scale, fine=fine)


def _without_boxes(stage: TrainConfig, density: DensityControl) -> TrainConfig:
    """The settings of a box stage that need no boxes."""
    return replace(
        stage,
        mechanisms=(
            *stage.chosen(MeasuredShRate),
            density,
            *stage.chosen(WarmRestarts, ModelAveraging, OpacityDecay),
            *stage.chosen(ImportancePruning, FloaterPruning),
        ),
    )


def cutout_stage(config: RunConfig) -> TrainConfig:
    """The stage that makes cut-out objects look right; settings as at the box stage's end."""
    steps = max(1, round(CUTOUT_SHARE * config.roi.steps))
    stage = replace(
        config.roi, steps=steps, sh_start=config.roi.sh_degree, lr_means=config.roi.lr_means / 10
    )
    stage = _no_more(stage.only(MaskedSteps, MeasuredShRate))
    return stage.using(CutoutSteps(), ModelAveraging(steps=steps // 2))


def surface_stage(config: RunConfig) -> TrainConfig:
    """The stage that turns the result into a surface.

    Its settings are the box stage's at its end, with masked steps only. Its changes outside the
    boxes are not used.
    """
    steps = max(1, round(SURFACE_SHARE * config.roi.steps))
    stage = replace(
        config.roi,
        steps=steps,
        sh_start=config.roi.sh_degree,
        lr_means=SURFACE_RATE * config.roi.lr_means,
        lr_means_final=SURFACE_RATE * config.roi.lr_means / 10,
    )
    stage = stage.only(MeasuredShRate)
    masks = config.roi.get(MaskedSteps) or MaskedSteps()
    return stage.using(
        replace(masks, whole_share=0.0, reinvested=0.0),
        SurfaceLosses(),
        ModelAveraging(steps=steps // 4),
    )


def _no_more(stage: TrainConfig) -> TrainConfig:
    """Keep the steps of a short stage as they are: masks do not add any."""
    masks = stage.get(MaskedSteps)
    return stage if masks is None else stage.using(replace(masks, reinvested=0.0))


def shortened(config: TrainConfig, share: float) -> TrainConfig:
    """Shorten a stage for a share of the photos: scale its steps and intervals by `share`.

    So each photo is used as often as in the whole stage, and a Gaussian is seen as often between
    two densifications. The number of densifications stays the same despite rounding.
    """
    short = miniature(config, max(1, round(share * config.steps)))
    before, density = config.get(DensityControl), short.get(DensityControl)
    if before is None or density is None:
        return short
    ratio = density.every / before.every
    begin, end = (round(ratio * step) for step in (before.start, before.until))
    return short.using(replace(density, start=begin, until=min(end, short.steps)))


def surroundings_stage(config: TrainConfig, share: float) -> TrainConfig:
    """The stage for a part of the scene without boxes, on a share of the photos; no masks.

    It uses no background points, because other parts of the scene are behind it. It uses no opacity
    decay, because other photos show it.
    """
    masks, density = config.get(MaskedSteps), _outside_density(config)
    grows = (WarmRestarts, ImportancePruning) if density else ()
    mechanisms = (
        *config.chosen(MeasuredShRate),
        *((density,) if density else ()),
        *config.chosen(IdlePruning, ModelAveraging, *grows),
    )
    whole = replace(config, mechanisms=mechanisms)
    return shortened(whole, share * (WHOLE_SHARE if masks else 1))


def _outside_density(config: TrainConfig) -> DensityControl | None:
    """The densification outside a stage's boxes; None: there is none."""
    own = config.get(DensityControl)
    if not isinstance(own, BoxDensityControl):
        return own
    if not own.outside_threshold:
        return None
    settings = {each.name: getattr(own, each.name) for each in fields(DensityControl)}
    return DensityControl(**settings | {"grad_threshold": own.outside_threshold})


def block_stage(config: TrainConfig, share: float, photos: float) -> TrainConfig:
    """The stage for the boxes of a block and its surroundings.

    It uses no opacity decay, because other photos show the area beside the block. Its surroundings
    have no learning rate of their own, because each of its whole photos gets nearly twice as many
    steps.

    Args:
        config: of the stage for a whole scene.
        share: share of the photos that see boxes, for this block's boxes.
        photos: the block's share of all photos.
    """
    config = config.only(
        *(MaskedSteps, MeasuredShRate, DensityControl, IdlePruning, WarmRestarts),
        *(ModelAveraging, ImportancePruning, FloaterPruning, CutoutSteps, SurfaceLosses),
    )
    masks = config.get(MaskedSteps)
    if masks is None:
        return shortened(config, max(share, photos))
    masked = (1 - masks.whole_share) * share
    whole = WHOLE_SHARE * photos
    masks = replace(masks, whole_share=whole / (masked + whole), reinvested=0.0)
    return shortened(config.using(masks), masked + whole)


def _densify_steps(config: RunConfig) -> int:
    """Number of densifying steps of a baseline."""
    return int(config.baseline_densify * config.total_steps + 1e-9)


def object_stage(config: RunConfig) -> TrainConfig:
    """The settings of an Object-GS: the box stage without the joint refinement's steps."""
    return with_steps(config.roi, config.roi.steps - config.refine_steps)


def refine_stage(config: RunConfig) -> TrainConfig:
    """The settings of the joint refinement: the joint stage's, without new Gaussians."""
    steps = config.refine_steps
    stage = replace(
        joint_recipe("", config.scene.steps, config.roi.steps).roi,
        steps=steps,
        sh_degree=config.roi.sh_degree,
        sh_start=config.roi.sh_degree,
        made_for=config.roi.made_for,
    )
    stage = _no_more(stage.only(MaskedSteps, MeasuredShRate, ModelAveraging, FloaterPruning))
    return stage.using(ModelAveraging(steps=steps // 2))
