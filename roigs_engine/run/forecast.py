"""Forecasts a plan's Gaussians, seconds and disk space, without finished work.

The time of a step is measured by training a few steps on the stage's cameras and masks, twice: with
the number of Gaussians at the start of the stage, and with the number expected at its end. In
between, it is interpolated. A rule of thumb gives the number of Gaussians that densification adds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..colmap.undistort import PER_PIXEL, missing_in
from ..context import QUIET, Context
from ..errors import EngineError
from ..formats.events import Event, Message, Progress
from ..formats.run_files import CACHE
from ..formats.text import counted, duration, json_digest
from ..gpu.program import opened
from ..kernels import library
from ..machine import disk_message
from ..model.gaussians import Gaussians
from ..model.scene import PosedImage, SfmScene
from ..training.loop import one_torch_thread
from ..training.mechanisms.box_density_control import BoxDensityControl
from ..training.mechanisms.density_control import DensityControl
from ..training.mechanisms.idle_pruning import IdlePruning
from ..training.mechanisms.importance_pruning import ImportancePruning
from ..training.mechanisms.masked_steps import MaskedSteps
from ..training.stage_data import StageData
from ..training.trainer import Trainer
from .definition import Run
from .executor import Executor
from .plan import POINTS, Plan, Source, Stage

WORTH_SAYING = 2000  # steps left; an estimate takes as long as a few hundred steps
PER_GAUSSIAN = 62 * 4  # bytes in a PLY with SH of degree 3
PER_STATE = 4 * 62 * 4  # bytes in a checkpoint: parameters, two moments, the mean of models
CHECKPOINTS = 3  # the last one, the one before, and the one being written
OUTPUTS = 4  # size of the outputs, in models: result, background, the boxes' Gaussians, preview


@dataclass(frozen=True, kw_only=True)
class StageForecast:
    """Estimates for a whole stage; measured values for a finished one."""

    stage: Stage
    end: int  # Gaussians at the end
    most: int  # the largest number during training
    seconds: float  # of training
    step_seconds: float  # of a step at the end
    steps_done: int = 0
    is_done: bool = False

    @property
    def done(self) -> float:
        """Finished seconds of training."""
        share = 1.0 if self.is_done else self.steps_done / max(self.stage.config.steps, 1)
        return min(1.0, share) * self.seconds


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Estimates for a plan."""

    stages: Sequence[StageForecast]  # in the order of training
    evaluation: float  # seconds to evaluate all models
    device: str  # the training device, in words

    def counting_down(self, context: Context) -> Context:
        """A context that adds the time to the end of the run to each stage's progress."""
        after, later = self.evaluation, {}
        for each in reversed(self.stages):
            later[each.stage.name] = after
            after += each.seconds - each.done

        def emit(event: Event) -> None:
            if isinstance(event, Progress) and event.stage in later:
                left = event.seconds_left + later[event.stage]
                event = replace(event, run_seconds_left=left)
            context.emit(event)

        return replace(context, emit=emit)

    def time_line(self) -> str:
        """One line with the minutes."""
        saved = sum(stage.done for stage in self.stages)
        seconds = sum(stage.seconds for stage in self.stages) - saved + self.evaluation
        done = f"; {duration(saved)} are already done" if saved else ""
        return f"Time: about {duration(seconds)} on this machine ({self.device}){done}."


def forecast_if_long(run: Run, plan: Plan, context: Context) -> Forecast | None:
    """Call `forecast`; None if little is left to train, or if it fails (it only informs)."""
    executor = Executor(run, context)
    found = [(stage, executor.status(stage)) for stage in plan.stages]
    left = sum(stage.config.steps - step for stage, step in found if isinstance(step, int))
    with suppress(EngineError, MemoryError, RuntimeError):
        return forecast(run, plan, context) if left >= WORTH_SAYING else None
    return None


def forecast(run: Run, plan: Plan, context: Context) -> Forecast:
    """Estimate a plan; trains a few steps to measure their time."""
    executor, estimator = Executor(run, context), Estimator(run.train_scene, context)
    ends: dict[str, int] = {}
    stages = []
    for stage in plan.stages:
        status = executor.status(stage)
        if isinstance(status, int):
            start = expected_start(stage.start, ends, run.train_scene)
            found = replace(estimator.estimate(stage, start), steps_done=status)
        else:
            record = status.record
            found = StageForecast(
                stage=stage,
                end=record.gaussians,
                most=record.gaussians,
                seconds=record.seconds,
                step_seconds=record.seconds / max(stage.config.steps, 1),
                is_done=True,
            )
        ends[stage.name] = found.end
        stages.append(found)
    # The time to render and compare the test photos, for each stage's model.
    tests = RENDER_SHARE * len(run.measured)
    return Forecast(
        stages=stages,
        evaluation=sum(tests * stage.step_seconds for stage in stages),
        device=_in_words(context.device),
    )


def _in_words(device: str) -> str:
    """The training device, in words."""
    if device != "cpu":
        return device
    gpu = opened()
    return counted(library.threads(), "thread") if gpu is None else gpu.adapter.title


def expected_start(source: Source, ends: dict[str, int], scene: SfmScene) -> int:
    """The expected number of Gaussians of a source; `ends`: at the end of earlier stages."""
    if source.kind == POINTS:
        return len(scene.points) if source.rows is None else len(source.rows)
    own = [ends[stage.name] for stage in source.inputs]
    if source.partition is not None:  # each result also has Gaussians that its neighbours own
        owned = np.bincount(source.partition.owner, minlength=len(own))
        points = len(scene.points)
        shares = owned / max(points, 1) / [s.start_share(points) for s in source.inputs]
        return round(float((shares.clip(max=1) * own).sum()))
    base = expected_start(source.base, ends, scene) if source.base else 0
    return max([round(source.share * base), *own])


def disk_space(run: Run, expected: Forecast) -> Message:
    """A message on the run's peak disk space; a warning if less is free."""
    missing = [stage for stage in expected.stages if not stage.is_done]
    distorted = missing_in(run.folder / CACHE, run.scene.images)
    needed = PER_PIXEL * sum(image.camera.width * image.camera.height for image in distorted)
    if missing:
        ends = [stage.end for stage in missing]
        needed += PER_STATE * CHECKPOINTS * max(stage.most for stage in missing)
        needed += PER_GAUSSIAN * (sum(ends) + OUTPUTS * max(ends))
    return disk_message(needed, run.folder)


# A densification adds the share GROWTH to a small model, and less to a larger one: half of it to a
# model of HALF Gaussians. Measured in two scenes whose growth differs by a factor of 2
# (notebook/densification.md).
GROWTH, HALF, SATURATION = 0.4, 100_000, 1.3
TRAINED = 0.3  # of that growth, outside the boxes of a trained model (35 % on kumamon)
PRUNED = 0.3  # share of the Gaussians that importance pruning removes (24 to 39 % in two scenes)
WARM_UP, MEASURED = 4, 12  # steps
MOST_MEASURED = 300_000  # Gaussians; for more, the time is extrapolated
RENDER_SHARE = 0.5  # of a training step's time, to render and compare a test photo


class Estimator:
    """Estimates the stages of one run; measures stages with the same settings once.

    The timed models are made from the scene's points.
    """

    def __init__(self, scene: SfmScene, context: Context = QUIET) -> None:
        self._scene, self._context = scene, context
        self._times: dict[tuple[object, ...], tuple[float, float]] = {}

    def estimate(self, stage: Stage, start: int) -> StageForecast:
        """The estimate of a stage that starts with `start` Gaussians."""
        counts = expected_counts(stage, start, self._share_in_boxes(stage))
        end, most = counts[-1], max(counts)
        seconds = self._line(stage, start, most)
        return StageForecast(
            stage=stage,
            end=end,
            most=most,
            seconds=sum(map(seconds, counts)),
            step_seconds=seconds(end),
        )

    def _line(self, stage: Stage, start: int, most: int) -> Callable[[int], float]:
        """A function: number of Gaussians -> seconds of a step."""
        few, many = min(start, MOST_MEASURED), min(most, MOST_MEASURED)
        low, high = self._step_seconds(stage, few, many)
        slope = (high - low) / (many - few) if many > few else high / max(few, 1)
        return lambda count: low + slope * (count - few)

    def _share_in_boxes(self, stage: Stage) -> float:
        """Share of the scene's points that lie in the stage's boxes."""
        inside = np.zeros(len(self._scene.points), dtype=bool)
        for roi in stage.rois:
            inside |= roi.contains(self._scene.points)
        return float(inside.mean()) if len(inside) else 0.0

    def _step_seconds(self, stage: Stage, start: int, end: int) -> tuple[float, float]:
        """Seconds of a step with `start` and with `end` Gaussians."""
        largest = max(image.camera.width * image.camera.height for image in stage.images)
        settings = replace(stage.config, steps=0).to_dict()
        key = (json_digest(settings), largest, _rounded(start), _rounded(end))
        if key not in self._times:
            first = self._measured(stage, start)
            last = first if end == start else self._measured(stage, end)
            self._times[key] = first, max(first, last)
        return self._times[key]

    def _measured(self, stage: Stage, count: int) -> float:
        """Seconds of a training step with `count` Gaussians, the median of a few."""
        self._context.check_cancelled()
        images = stage.images[:: max(1, len(stage.images) // 8)]
        data = StageData(
            images=images,
            photos=_GreyPhotos(images),
            photo_at=lambda step: step % len(images),
            extent=stage.extent,
            rois=stage.rois,
            device=torch.device(self._context.device),
        )
        config = replace(stage.config, steps=WARM_UP + MEASURED).only(MaskedSteps, IdlePruning)
        if masks := config.get(MaskedSteps):
            config = config.using(replace(masks, view_weighting=0.0, seeing=()))
        trainer = Trainer(model_of_size(self._scene, count), data, config)
        times = []
        with one_torch_thread():
            for _ in range(WARM_UP + MEASURED):
                began = time.perf_counter()
                trainer.train_step()
                if data.device.type == "cuda":
                    torch.cuda.synchronize(data.device)
                times.append(time.perf_counter() - began)
        return float(np.median(times[WARM_UP:]))


@dataclass
class _Growing:
    """Gaussians with one threshold: number, number at half growth, limit, relative speed."""

    count: float
    half: float
    limit: float
    speed: float

    def grow(self) -> None:
        """Apply one densification."""
        share = min(1.0, GROWTH * self.speed / (1 + (self.count / self.half) ** SATURATION))
        self.count = max(self.count, min(self.count * (1 + share), self.limit))


def expected_counts(stage: Stage, start: int, share_in_boxes: float) -> list[int]:
    """Number of Gaussians at each step of a stage, by the rule of thumb."""
    density, counts = stage.config.get(DensityControl), []
    pruning = stage.config.get(ImportancePruning)
    prunes = density is not None and pruning is not None and pruning.acts(stage.config)
    parts = _growing(density, start, share_in_boxes)
    for step in range(1, stage.config.steps + 1):
        if density is not None and density.grows(step):
            for part in parts:
                part.grow()
        if density is not None and prunes and step == density.until:
            for part in parts:
                part.count *= 1 - PRUNED
        counts.append(round(sum(part.count for part in parts)))
    return counts


def _growing(density: DensityControl | None, start: int, share_in_boxes: float) -> list[_Growing]:
    """The Gaussians of a stage; separately inside and outside boxes if thresholds differ."""
    usual = DensityControl.grad_threshold
    speed = usual / density.grad_threshold if density else 0.0
    if not (isinstance(density, BoxDensityControl) and density.box_sizes):
        return [_Growing(float(start), HALF, math.inf, speed)]
    share, limit = share_in_boxes, math.inf  # detail in proportion to their share of the scene
    if density.budgets is not None:
        limit = float(sum(density.budgets))
    inside = _Growing(start * share, max(1.0, HALF * share), limit, speed)
    outside, rest = density.outside_threshold, 1 - share
    speed = TRAINED * usual / outside if outside else 0.0
    return [inside, _Growing(start * rest, max(1.0, HALF * rest), math.inf, speed)]


def model_of_size(scene: SfmScene, count: int) -> Gaussians:
    """Make `count` Gaussians from the scene's points: some of them, or all with smaller copies."""
    rng = np.random.default_rng(0)
    rows = rng.permutation(len(scene.points))[:count]
    copies = -(-count // max(len(rows), 1))
    model = Gaussians.from_points(scene.points[rows], scene.colors[rows])
    if copies == 1:
        return model
    values = {name: torch.cat([each] * copies)[:count] for name, each in model.tensors().items()}
    spread = values["log_scales"].exp()
    generator = torch.Generator().manual_seed(0)
    values["means"] = values["means"] + spread * torch.randn(count, 3, generator=generator)
    values["log_scales"] = values["log_scales"] - float(np.log(copies)) / 2  # same total area
    return model.with_tensors(values)


class _GreyPhotos:
    """Grey photos for timing: a photo's content hardly changes the time of a step."""

    def __init__(self, images: Sequence[PosedImage]) -> None:
        self._images = images

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        camera = self._images[index].camera
        return np.full((camera.height, camera.width, 3), 128, dtype=np.uint8)

    def prefetch(self, indices: Sequence[int]) -> None:
        """Do nothing: there is nothing to decode."""


def _rounded(count: int) -> int:
    """Equal for counts within 5 %, which share one measurement."""
    return round(20 * float(np.log(max(count, 1))))
