"""The preferences' buttons: set up the engine, stop that, say what is missing."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from .. import jobs, preferences, terminal
from ..engine import check, install
from ..errors import AddonError
from .base import FRESH, OperatorResult, available, failed

POLL_SECONDS = 0.3
OFFLINE = (
    "Blender is offline. Allow online access in Preferences ▸ System ▸ Network, or set up from a"
    " folder of wheels."
)


class SetUpEngine(bpy.types.Operator):
    """Make a Python environment with torch for the engine, in the extension's own folder"""

    bl_idname = "roigs.setup_engine"
    bl_label = "Set Up the Engine"

    cuda: BoolProperty(
        name="For NVIDIA Cards",
        description="The build of torch for CUDA: a download of several gigabytes",
        options=FRESH,
    )
    wheels: StringProperty(
        name="Folder of Wheels",
        subtype="DIR_PATH",
        description="Install from this folder, without a network (empty: from PyPI)",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One at a time."""
        reason = "The engine is being set up" if install.running() else ""
        return available(cls, reason or ("The engine is busy" if jobs.busy() else ""))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """In a script: wait for the end."""
        try:
            installation = install.begin(self._plan())
        except AddonError as error:
            return failed(self, error)
        line = terminal.Terminal(sys.stderr)
        with terminal.stopping(installation.stop):
            while not installation.finished:
                line.show(f"{installation.title}, {installation.fraction:.0%}")
                time.sleep(POLL_SECONDS)
        line.close()
        finish()
        if installation.message:
            return failed(self, AddonError(installation.message))
        self.report({"INFO"}, f"The engine is set up: {installation.python}")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Start, and leave the window to its user; the preferences page shows how it goes."""
        if bpy.app.background:
            return self.execute(context)
        try:
            install.begin(self._plan())
        except AddonError as error:
            return failed(self, error)
        bpy.app.timers.register(_tick, first_interval=POLL_SECONDS, persistent=True)
        return {"FINISHED"}

    def _plan(self) -> install.Plan:
        wheels = Path(bpy.path.abspath(self.wheels)) if self.wheels else None
        if wheels is None and not bpy.app.online_access:
            raise AddonError(OFFLINE)
        if wheels is not None and not wheels.is_dir():
            raise AddonError(f"There is no folder {wheels}. Choose the folder of the wheels.")
        return install.Plan(
            home=preferences.environments(), cuda=self.cuda, wheels=wheels, in_use=jobs.busy
        )


def _tick() -> float | None:
    """Blender's timer: again in so many seconds, or never."""
    jobs.redraw("PREFERENCES")
    if install.running():
        return POLL_SECONDS
    finish()
    jobs.redraw("PREFERENCES")
    return None


def finish() -> None:
    """Look again at what there is."""
    check.check(preferences.chosen_python(), preferences.environments())


class StopSetUp(bpy.types.Operator):
    """Stop setting up; an engine that was there before stays"""

    bl_idname = "roigs.stop_setup"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something must be running."""
        return available(cls, "" if install.running() else "Nothing is being set up")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """End it."""
        assert install.current is not None
        install.current.stop()
        return {"FINISHED"}


class CheckEngine(bpy.types.Operator):
    """Say what the engine can do here, and what it lacks"""

    bl_idname = "roigs.check_engine"
    bl_label = "Check"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Ask the Pythons that there are."""
        for finding in check.check(preferences.chosen_python(), preferences.environments()):
            self.report({"INFO" if finding.works else "WARNING"}, finding.text)
        return {"FINISHED"}


CLASSES = (SetUpEngine, StopSetUp, CheckEngine)


def register() -> None:
    """The classes."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """The reverse; a set-up that runs is ended."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    install.forget()
    check.forget()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
