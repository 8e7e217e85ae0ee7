"""What a plan's stages will take: Gaussians and seconds, with what is done already."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..context import Context
from ..errors import EngineError
from ..formats.text import counted
from ..kernels import library
from ..model.scene import SfmScene
from .definition import Run
from .estimate import Estimator, StageEstimate, evaluation_seconds
from .executor import Executor
from .plan import POINTS, Plan, Source, Stage
from .stage_folder import StageStatus

WORTH_SAYING = 2000  # steps; an estimate takes as long as a few hundred of them


@dataclass(frozen=True, kw_only=True)
class StageForecast:
    """What is expected of a stage, or known of a finished one.

    Attributes:
        stage: the stage.
        status: how far it is.
        whole: the whole stage, from its first step.
    """

    stage: Stage
    status: StageStatus
    whole: StageEstimate

    @property
    def is_done(self) -> bool:
        """Whether it is finished."""
        return self.status.result is not None

    @property
    def done(self) -> float:
        """Seconds of training that are done."""
        steps = self.stage.config.steps
        share = 1.0 if self.is_done else min(1.0, self.status.step / max(steps, 1))
        return share * self.whole.seconds

    @property
    def missing(self) -> float:
        """Seconds of training that are left."""
        return self.whole.seconds - self.done


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """What a plan will take.

    Attributes:
        stages: in the order of training.
        evaluation: seconds to evaluate all models.
        device: what trains, for the text.
    """

    stages: Sequence[StageForecast]
    evaluation: float
    device: str

    def time_line(self) -> str:
        """One line with the minutes."""
        seconds = sum(stage.missing for stage in self.stages) + self.evaluation
        saved = sum(stage.done for stage in self.stages)
        done = f"; {_minutes(saved)} are already done" if saved else ""
        return f"Time: about {_minutes(seconds)} on this machine ({self.device}){done}."


def forecast(run: Run, plan: Plan, context: Context, *, update: bool) -> Forecast:
    """What a plan will take; trains a few steps to measure their time.

    Args:
        run, plan: the run and its plan.
        context: gives the device; checked for cancellation.
        update: whether results would be restored from the archive.
    """
    return _forecast(run, plan, _statuses(run, plan, context, update=update), context)


def forecast_if_long(run: Run, plan: Plan, context: Context, *, update: bool) -> Forecast | None:
    """`forecast`; None if little is left to train, or if it fails: it is only a text."""
    statuses = _statuses(run, plan, context, update=update)
    left = [
        stage.config.steps - status.step
        for stage, status in zip(plan.stages, statuses, strict=True)
        if status.result is None
    ]
    if sum(left) < WORTH_SAYING:
        return None
    with suppress(EngineError, MemoryError, RuntimeError):
        return _forecast(run, plan, statuses, context)
    return None


def _statuses(run: Run, plan: Plan, context: Context, *, update: bool) -> list[StageStatus]:
    executor = Executor(run, context, update=update)
    return [executor.status(stage) for stage in plan.stages]


def _forecast(run: Run, plan: Plan, statuses: Sequence[StageStatus], context: Context) -> Forecast:
    estimator = Estimator(run.train_scene, context)
    ends: dict[str, int] = {}
    stages = []
    for stage, status in zip(plan.stages, statuses, strict=True):
        if status.result is None:
            start = expected_start(stage.start, ends, run.train_scene)
            whole = estimator.estimate(stage, start)
        else:
            result = status.result
            each = result.seconds / max(stage.config.steps, 1)
            whole = StageEstimate(
                end=result.count, most=result.count, seconds=result.seconds, step_seconds=each
            )
        ends[stage.name] = whole.end
        stages.append(StageForecast(stage=stage, status=status, whole=whole))
    return Forecast(
        stages=stages,
        evaluation=evaluation_seconds([stage.whole for stage in stages], len(run.measured)),
        device=(
            counted(library.threads(), "thread") if context.device == "cpu" else context.device
        ),
    )


def expected_start(source: Source, ends: dict[str, int], scene: SfmScene) -> int:
    """The expected number of Gaussians of a source.

    Args:
        source: what a stage starts from.
        ends: the number at the end of each stage before.
        scene: of the training photos.
    """
    if source.kind == POINTS:
        return len(scene.points) if source.rows is None else len(source.rows)
    own = [ends[stage.name] for stage in source.inputs]
    if source.partition is not None:  # each result has some of what its neighbours own, too
        owned = np.bincount(source.partition.owner, minlength=len(own))
        points = len(scene.points)
        shares = owned / max(points, 1) / [s.start_share(points) for s in source.inputs]
        return round(float((shares.clip(max=1) * own).sum()))
    base = expected_start(source.base, ends, scene) if source.base else 0
    return max([round(source.share * base), *own])


def _minutes(seconds: float) -> str:
    if seconds < 90:
        return counted(max(1, round(seconds)), "second")
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.1f} hours"
