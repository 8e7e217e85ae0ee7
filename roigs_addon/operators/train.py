"""Step «Train»: the engine refines the boxes; stop, go on, see the log."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty

from .. import facts, jobs, lookup, preferences, requests, run_folders, splats
from ..engine import runs
from ..engine.client import Outcome
from .base import FRESH, EngineJob, OperatorResult, available
from .select import blocked

LOG = "ROI-GS log"
LAST_LINES = 20
"""How many lines of the log's end are in sight when it is opened."""


class TrainRoi(EngineJob, bpy.types.Operator):
    """Train the scene and refine the boxes; a training that was stopped goes on"""

    bl_idname = "roigs.train_roi"
    bl_label = "Train ROI"

    active_only: BoolProperty(name="Active Box Only", default=False, options=FRESH)
    selected_only: BoolProperty(name="Selected Boxes Only", default=False, options=FRESH)
    go_on: BoolProperty(
        name="Continue",
        description="Only the boxes of the training that was stopped, unless one of them is gone",
        default=False,
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A model, a box, and an engine, at rest."""
        missing = "" if bpy.app.background else facts.engine_problem()
        return available(cls, blocked(context) or missing)

    def work(self, context: bpy.types.Context) -> jobs.Work:
        """Train in the scene's run folder, then bring the Gaussians back."""
        scene = context.scene
        rois = self._rois(context)
        seconds = getattr(preferences.get(), "preview_seconds", 5.0)
        request = requests.write_training_request(
            scene, rois, 0.0 if bpy.app.background else seconds
        )
        folder, find = run_folders.run_folder(scene), run_folders.finder(scene)

        def preview(path: Path) -> None:
            if now := find():
                splats.show_preview(now, path)

        def take(_: Outcome) -> None:
            if now := find():
                splats.show_results(now, folder)

        return jobs.Work(
            title="Training",
            arguments=["train", str(request), "--run-dir", str(folder)],
            log=folder / "blender" / "engine.log",
            folder=folder,
            on_preview=preview,
            on_done=take,
        )

    def _rois(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        active, every = lookup.active_roi(context), lookup.rois(context.scene)
        if self.active_only and active is not None:
            return [active]
        if self.selected_only:
            return [roi for roi in every if roi.select_get()]
        found = facts.run(context.scene)
        if self.go_on and found.begun and found.boxes:
            # With other boxes the engine would put away what it has of these.
            theirs = [roi for roi in every if roi.name in found.boxes]
            return theirs if len(theirs) == len(found.boxes) else every
        return every


class StopJob(bpy.types.Operator):
    """Stop the engine; what it has done is kept, and «Train ROI» goes on from there"""

    bl_idname = "roigs.stop"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something must be running."""
        return available(cls, "" if jobs.busy() else "Nothing is running")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Ask the engine."""
        assert jobs.current is not None
        jobs.current.stop()
        return {"FINISHED"}


class ShowLog(bpy.types.Operator):
    """Open the engine's log in the text editor"""

    bl_idname = "roigs.show_log"
    bl_label = "Show Log"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be one."""
        return available(cls, "" if log_path(context) else "There is no log yet")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Load it as a text, in an editor when one is open, else in a window of its own."""
        path = log_path(context)
        assert path is not None
        text = bpy.data.texts.get(LOG) or bpy.data.texts.new(LOG)
        text.from_string(path.read_text(encoding="utf-8", errors="replace"))
        if bpy.app.background:
            return {"FINISHED"}
        windows = context.window_manager.windows
        areas = (area for window in windows for area in window.screen.areas)
        area = next((area for area in areas if area.type == "TEXT_EDITOR"), None)
        if area is None:
            bpy.ops.wm.window_new()
            area = windows[-1].screen.areas[0]
            area.type = "TEXT_EDITOR"
        space = area.spaces.active
        space.text, space.show_word_wrap = text, True
        space.top = max(0, len(text.lines) - LAST_LINES)
        return {"FINISHED"}


def log_path(context: bpy.types.Context) -> Path | None:
    """The log of the last job, or of the run folder's."""
    named = context.window_manager.roigs.log
    path = (
        Path(named) if named else run_folders.run_folder(context.scene) / "blender" / "engine.log"
    )
    return path if facts.is_file(path) else None


def unfinished(scene: bpy.types.Scene) -> str:
    """The stage at which the run folder's training was left, or nothing."""
    return runs.read(run_folders.run_folder(scene)).left


def finished(scene: bpy.types.Scene) -> list[str]:
    """The stages that are done in the run folder."""
    return list(runs.read(run_folders.run_folder(scene)).done)


CLASSES = (TrainRoi, StopJob, ShowLog)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
