"""The models that a strategy makes of a run's stages, in the order of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..evaluation.views import EvaluatedModel
from ..model.gaussians import Gaussians
from ..training.stage import StageResult

if TYPE_CHECKING:
    from .pipeline import Run

BASELINE = "Full Scene"


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainedModel:
    """A model and the stages behind it.

    Attributes:
        name: of its row, unique among the rows of a box.
        gaussians: the model.
        stages: that serve all boxes alike.
        by_roi: box -> the stage that serves it alone.
    """

    name: str
    gaussians: Gaussians
    stages: Sequence[StageResult] = ()
    by_roi: dict[str, StageResult] = field(default_factory=dict)

    @classmethod
    def of_stage(cls, name: str, stage: StageResult, roi: str = "") -> TrainedModel:
        """What a stage ended with, for one box or for all."""
        if roi:
            return cls(name=name, gaussians=stage.gaussians, by_roi={roi: stage})
        return cls(name=name, gaussians=stage.gaussians, stages=[stage])

    @property
    def rois(self) -> tuple[str, ...] | None:
        """The boxes that get a row for it; None: all, as some stage serves all."""
        return None if self.stages else tuple(self.by_roi)

    @property
    def all_stages(self) -> list[StageResult]:
        """Every stage behind it."""
        return [*self.stages, *self.by_roi.values()]

    def stages_for(self, roi: str) -> list[StageResult]:
        """The stages that this model needs if the box is the only one."""
        return [*self.stages, *([self.by_roi[roi]] if roi in self.by_roi else [])]

    def evaluated(self) -> EvaluatedModel:
        """Its row, which took the time of all its stages."""
        return EvaluatedModel(
            name=self.name,
            gaussians=self.gaussians,
            seconds=sum(stage.seconds for stage in self.all_stages),
            rois=self.rois,
            stages={stage.name: stage.seconds for stage in self.all_stages},
        )


def full_scene(run: Run) -> TrainedModel:
    """The baseline that all is compared with."""
    return TrainedModel.of_stage(BASELINE, run.full_scene())


def full_objects(run: Run) -> list[TrainedModel]:
    """The Full Object of each box."""
    return [
        TrainedModel.of_stage("Full Object", run.full_object(roi), roi.name) for roi in run.rois
    ]


def own_models(run: Run) -> list[TrainedModel]:
    """The models of the run's strategy, its result last."""
    return _joint(run) if run.config.strategy == "joint" else _independent(run)


def _joint(run: Run) -> list[TrainedModel]:
    scene, joint = run.scene_stage(), run.joint_stage()
    return [
        TrainedModel.of_stage("Scene-GS (joint)", scene),
        TrainedModel(name="Joint", gaussians=joint.gaussians, stages=[scene, joint]),
    ]


def _independent(run: Run) -> list[TrainedModel]:
    scene = run.scene_stage()
    objects = {roi.name: run.object_stage(roi) for roi in run.rois}
    in_order = list(objects.values())
    composed = run.composed(scene, in_order)
    models = [
        TrainedModel.of_stage("Scene-GS", scene),
        *(TrainedModel.of_stage("Object-GS", stage, roi) for roi, stage in objects.items()),
        TrainedModel(name="Composition", gaussians=composed, stages=[scene], by_roi=objects),
    ]
    if run.config.seam_steps:
        seam = run.seam_stage(scene, in_order)
        models.append(
            TrainedModel(
                name="Composition, refined",
                gaussians=seam.gaussians,
                stages=[scene, seam],
                by_roi=objects,
            )
        )
    return models
