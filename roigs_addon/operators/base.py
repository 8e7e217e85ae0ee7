"""What operators share: errors become reports, and engine jobs run with or without a window."""

from __future__ import annotations

from typing import Any

import bpy

from .. import jobs, preferences
from ..engine.python import FOR_TRAINING
from ..errors import AddonError

OperatorResult = set[str]

FRESH = {"SKIP_SAVE"}
"""For every property: else Blender takes over what the call before had, be it another button's."""


def failed(operator: bpy.types.Operator, error: AddonError) -> OperatorResult:
    """Report an error: a line in the window, RuntimeError in a script."""
    operator.report({"ERROR"}, str(error))
    return {"CANCELLED"}


def available(cls: type[bpy.types.Operator], reason: str) -> bool:
    """For `poll`: False with a tooltip that says why, when there is a reason."""
    if reason:
        cls.poll_message_set(reason)
    return not reason


class EngineJob:
    """Mixin of operators that run the engine.

    `execute` waits for the end: scripts and `blender -b`. `invoke`, which buttons call, returns at
    once; the operator then stays only to hear Esc, while `jobs` follows the engine, takes in what
    it has made and makes the undo step: these operators have no «UNDO» among their options.
    """

    packages: tuple[str, ...] = FOR_TRAINING

    def work(self, context: bpy.types.Context) -> jobs.Work:
        """What to run; raises AddonError."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Run to the end."""
        try:
            runner = jobs.start(preferences.engine(self.packages), self.work(context))
        except AddonError as error:
            return failed(self, error)
        outcome = jobs.wait(runner)
        if outcome.failed:
            return failed(self, AddonError(outcome.message))
        if outcome.stopped:
            self.report({"WARNING"}, "Stopped.")
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Start, and leave the window to its user."""
        if bpy.app.background:
            return self.execute(context)
        try:
            self._runner = jobs.start(preferences.engine(self.packages), self.work(context))
        except AddonError as error:
            return failed(self, error)
        # Events other than the timer's would come only when the mouse moves.
        self._timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._runner.hears_esc = True
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Esc stops the job; everything else goes to the window."""
        runner: Any = self._runner
        if runner.finished:
            context.window_manager.event_timer_remove(self._timer)
            if runner.outcome.failed:
                # An error would pop up over the panel, which has the message to stay.
                self.report({"WARNING"}, runner.outcome.message)
                return {"CANCELLED"}
            return {"FINISHED"}
        if event.type == "ESC" and event.value == "PRESS" and not runner.stopping:
            runner.stop()
            return {"RUNNING_MODAL"}
        return {"PASS_THROUGH"}
