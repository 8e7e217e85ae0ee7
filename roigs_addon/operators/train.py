"""Step 4, Train: the engine refines the boxes; stop, continue, show the log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty

from ..blender import registration, scene_of
from ..engine.own_files import log_file
from ..facts import engine_ability, run_facts
from ..jobs import current, estimate_job, run_folders, train_job
from ..jobs.spec import JobSpec
from ..scene import lookup
from . import texts
from .base import FRESH, EngineOperator, available, engine_problem, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult

LOG = "ROI-GS log"
NO_LOG = "There is no log yet"


class TrainRoi(EngineOperator):
    """Train the scene and refine the boxes; a stopped training resumes"""

    bl_idname = "roigs.train_roi"
    bl_label = "Train"

    active_only: BoolProperty(name="Active Box Only", default=False, options=FRESH)
    selected_only: BoolProperty(name="Selected Boxes Only", default=False, options=FRESH)
    resume: BoolProperty(
        name="Continue",
        description="Only the boxes of the stopped training; all if one of them is gone",
        default=False,
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model, a box, and an idle engine that can train."""
        return available(cls, _training_problem(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Train in the scene's run folder, then import the Gaussians."""
        return train_job.spec(scene_of(context), self._boxes(context))

    def _boxes(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        scene, active = scene_of(context), lookup.active_roi(context)
        if self.active_only and active is not None:
            return [active]
        if self.selected_only:
            return [box for box in lookup.rois(scene) if box.select_get()]
        if self.resume:
            return train_job.boxes_to_resume(scene, run_facts.run(scene))
        return lookup.rois(scene)


class EstimateTime(EngineOperator):
    """Train a few steps to estimate the time for all boxes"""

    bl_idname = "roigs.estimate_time"
    bl_label = "Estimate"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """As for training."""
        return available(cls, _training_problem(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """A training that only says what it would do."""
        return estimate_job.spec(scene_of(context))


def _training_problem(context: bpy.types.Context) -> str:
    """Why training is not available; empty if it is."""
    missing = "" if bpy.app.background else engine_ability.problem()
    return engine_problem(context) or missing


class StopJob(bpy.types.Operator):
    """Stop the engine. You can resume training, reconstruction and levels"""

    bl_idname = "roigs.stop"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A job must be running."""
        return available(cls, "" if current.busy() else "Nothing is running")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Ask the engine to stop."""
        if current.job is not None:
            current.job.stop()
        return {"FINISHED"}


class ShowLog(bpy.types.Operator):
    """Open the engine's log in the text editor"""

    bl_idname = "roigs.show_log"
    bl_label = "Show Log"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a log."""
        return available(cls, "" if log_path(scene_of(context)) else NO_LOG)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Load it as a text; show it in an open text editor, else in a new window."""
        path = log_path(scene_of(context))
        if path is None:
            return failed(self, f"{NO_LOG}.")
        texts.show(LOG, path, end=True)
        return {"FINISHED"}


def log_path(scene: bpy.types.Scene) -> Path | None:
    """The log of the last job, else that of the scene's run folder; None if there is none."""
    path = current.state().log or log_file(run_folders.run_folder(scene))
    return path if run_facts.is_file(path) else None


register, unregister = registration(TrainRoi, EstimateTime, StopJob, ShowLog)
