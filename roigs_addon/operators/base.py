"""Base of the operators: turns errors into reports, runs engine jobs with or without a window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from .. import settings
from ..blender import scene_of
from ..engine.python import FOR_TRAINING
from ..errors import AddonError
from ..facts import run_facts
from ..jobs import current
from ..jobs.job import Job
from ..jobs.spec import JobSpec
from ..properties import scene_props
from ..scene import lookup
from ..shared import text as texts

if TYPE_CHECKING:
    from ..blender import OperatorResult

BUSY = "The engine is busy. Wait, or stop it with Esc"
NO_RESULT = "Train first: the run folder has no result"
NO_BOX = "Add a box first"
NO_CAMERAS = "Reconstruct photos or import cameras first"
FRESH = {"SKIP_SAVE"}
"""For every property: otherwise Blender reuses the value of the previous call, from any button."""


def failed(operator: bpy.types.Operator, error: AddonError | str) -> OperatorResult:
    """Report an error: a line in the window, RuntimeError in a script."""
    tell(operator, "ERROR", str(error))
    return {"CANCELLED"}


def tell(operator: bpy.types.Operator, level: str, text: str) -> None:
    """Report a line: a terminal gets no control characters of names in it.

    Of names on disk that are no text, Blender takes none.
    """
    shown: set[Any] = {level}
    line = texts.printable(text).encode("utf-8", "backslashreplace").decode()
    operator.report(shown, line)


def available(cls: type[bpy.types.Operator], reason: str) -> bool:
    """For `poll`: False, with a tooltip that gives the reason, if there is one."""
    if reason:
        cls.poll_message_set(reason)
    return not reason


def box_problem(context: bpy.types.Context) -> str:
    """Why an operator on the active box is not available; empty if it is."""
    return "" if lookup.active_roi(context) else NO_BOX


def result_problem(context: bpy.types.Context) -> str:
    """Why nothing can be made of the last result now; empty if it can."""
    if current.busy():
        return BUSY
    return "" if run_facts.run(scene_of(context)).result else NO_RESULT


def own_problem(context: bpy.types.Context) -> str:
    """Why the scene cannot be changed; empty if it can."""
    linked = scene_of(context).library is not None
    return "This scene is of another file: open that, or make it local" if linked else ""


def model_problem(context: bpy.types.Context) -> str:
    """Why nothing can be done with the model now; empty if it can."""
    if current.busy():
        return BUSY
    return (
        ""
        if scene_props(scene_of(context)).colmap
        else "Reconstruct photos or import cameras first"
    )


def engine_problem(context: bpy.types.Context) -> str:
    """Why neither selection nor training can start; empty if they can."""
    boxes = lookup.rois(scene_of(context))
    no_box = "" if boxes else "First add a box around each object to sharpen"
    return model_problem(context) or no_box


class EngineOperator(bpy.types.Operator):
    """Base of the operators that run the engine.

    `execute` waits for the end: for scripts and `blender -b`. `invoke`, which buttons call, returns
    at once. The operator then only stays to hear Esc, while `jobs.current` follows the engine,
    imports its results and makes the undo step. So these operators do not have the option UNDO.
    """

    _job: Job

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """The job to run; raises AddonError."""
        raise NotImplementedError

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Packages that the engine's Python needs for the job."""
        return FOR_TRAINING

    def start(self, context: bpy.types.Context) -> Job:
        """Start the job; raises AddonError."""
        return current.start(settings.engine(self.packages(context)), self.spec(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Run to the end."""
        try:
            job = self.start(context)
        except AddonError as error:
            return failed(self, error)
        result = current.wait(job)
        if result.failed:
            return failed(self, result.message)
        if result.stopped:
            tell(self, "WARNING", job.state.message)
            return {"CANCELLED"}
        self._tell(job)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Start, and leave the window free."""
        if bpy.app.background:
            return self.execute(context)
        try:
            self._job = self.start(context)
        except AddonError as error:
            return failed(self, error)
        assert context.window_manager is not None
        context.window_manager.modal_handler_add(self)
        self._job.hears_esc = True
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Stop the job at Esc; all other events go to the window.

        Blender calls this at events only, so the operator ends with the first one after its job.
        """
        job = self._job
        if job.result is not None:
            if job.result.failed:
                # An error would pop up over the panel, which has the whole message.
                tell(self, "WARNING", f"{job.spec.title} failed: see the tab ROI-GS (N)")
                return {"CANCELLED", "PASS_THROUGH"}
            if not job.result.stopped:
                self._tell(job)
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "ESC" and event.value == "PRESS" and not job.stopping:
            job.stop()
            return {"RUNNING_MODAL"}
        return {"PASS_THROUGH"}

    def _tell(self, job: Job) -> None:
        if job.spec.done_text:
            tell(self, "INFO", job.spec.done_text)


class BrowsingOperator(EngineOperator):
    """Base of those whose button opens the file browser, which then calls `execute`."""

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Run to the end in a script; after the file browser, leave the window free."""
        if bpy.app.background or not self.options.is_invoke:
            return EngineOperator.execute(self, context)
        try:
            self.start(context)
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}
