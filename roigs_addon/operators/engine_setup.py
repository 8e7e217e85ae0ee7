"""Buttons of the preferences: set up the engine, stop that, check, remove."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .. import settings
from ..blender import registration
from ..engine import check, environments, install, python
from ..engine.graphics_card import BUILDS as TORCH_BUILDS
from ..engine.install_steps import Plan
from ..errors import AddonError
from ..facts import engine_ability, graphics_card, training_device
from ..jobs import current, terminal
from ..shared import clean_up
from ..windows import Timer, redraw
from .base import BUSY, FRESH, available, failed, tell

if TYPE_CHECKING:
    from ..blender import OperatorResult

POLL_SECONDS = 0.3
BUILDS = (
    (
        "AUTO",
        "Automatic",
        "For the NVIDIA card, if it and its driver can be used; otherwise for the CPU",
    ),
    ("CPU", "CPU", "Always for the CPU: the smallest download"),
    ("CUDA", "NVIDIA GPU", "For an NVIDIA card, also if none is found"),
)
"""Identifier, name and description of what may be installed."""
OFFLINE = (
    "Blender is offline. To download the engine, turn on Allow Online Access (Preferences ▸"
    " System ▸ Network), or choose a Folder of Wheels (Advanced)."
)


def _busy() -> str:
    """Why the engine's environments must stay as they are now; empty if they need not."""
    if install.running():
        return "The engine is being set up"
    return BUSY if current.busy() else ""


class SetUpEngine(bpy.types.Operator):
    """Create a Python environment with torch for the engine; all versions of Blender share it"""

    bl_idname = "roigs.setup_engine"
    bl_label = "Set Up the Engine"

    build: EnumProperty(
        name="Build",
        items=BUILDS,
        description="Build of torch; for NVIDIA cards, the download is several gigabytes",
        options=FRESH,
    )
    formats: BoolProperty(
        name="File Formats",
        default=True,
        description="Also install the packages for formats other than PLY",
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
        """There must be nothing else at work."""
        return available(cls, _busy())

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """In a script: run to the end."""
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
        look_again()
        if installation.message:
            return failed(self, installation.message)
        self.report({"INFO"}, f"The engine is set up: {installation.python}")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Start, and leave the window free; the preferences page shows the progress."""
        if bpy.app.background:
            return self.execute(context)
        try:
            install.begin(self._plan())
        except AddonError as error:
            return failed(self, error)
        timer.start()
        return {"FINISHED"}

    def _torch_index(self) -> str:
        """The package index of torch; empty: torch for the CPU."""
        if self.build == "CPU" or sys.platform == "darwin":
            return ""
        choice = graphics_card.choice(wait=True)
        if choice is not None and choice.build is not None:
            return choice.build.index
        return TORCH_BUILDS[0].index if self.build == "CUDA" else ""

    def _plan(self) -> Plan:
        wheels = Path(self.wheels) if self.wheels else None
        if wheels is None and not bpy.app.online_access:
            raise AddonError(OFFLINE)
        if self.wheels.startswith("//") or (wheels is not None and not wheels.is_dir()):
            raise AddonError(f"There is no folder {wheels}. Choose the folder with the wheels.")
        return Plan(
            environments=settings.environments(),
            torch_index=self._torch_index(),
            formats=self.formats,
            wheels=wheels,
        )


def _poll() -> bool:
    running = install.running()
    if not running:
        look_again()
    redraw("PREFERENCES")
    return running


timer = Timer(_poll, POLL_SECONDS, persistent=True)
"""Draws the preferences page again while an environment is being made."""


def look_again() -> tuple[check.Finding, ...]:
    """Check what the engine can do, and which device it trains on."""
    graphics_card.forget()
    training_device.forget()
    training_device.ask()
    return check.check(settings.chosen_python(), settings.environments())


class StopSetUp(bpy.types.Operator):
    """Stop setting up the engine; an existing one is kept"""

    bl_idname = "roigs.stop_setup"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """It must be running."""
        return available(cls, "" if install.running() else "Nothing is being set up")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """End it."""
        if install.current is not None:
            install.current.stop()
        return {"FINISHED"}


class CheckEngine(bpy.types.Operator):
    """Check the engine's abilities on this computer, and list missing packages"""

    bl_idname = "roigs.check_engine"
    bl_label = "Check"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Report every finding."""
        for finding in look_again():
            tell(self, "INFO" if finding.works else "WARNING", finding.text)
        if device := training_device.asked():
            tell(self, "INFO", training_device.in_words(device))
        return {"FINISHED"}


class RemoveEngine(bpy.types.Operator):
    """Delete the Python environments of Set Up the Engine; all versions of Blender share them"""

    bl_idname = "roigs.remove_engine"
    bl_label = "Remove"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be one, and nothing at work."""
        there = environments.made(settings.environments())
        return available(cls, _busy() or ("" if there else "There is nothing to remove"))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask first."""
        assert context.window_manager is not None
        size = clean_up.disk_size(environments.made(settings.environments()))
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Remove the engine?",
            message=f"This frees {size / 1e6:,.0f} MB. Runs and results stay.",
            confirm_text="Remove",
        )

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove them."""
        try:
            freed = environments.remove_all(settings.environments())
        except AddonError as error:
            return failed(self, error)
        finally:
            install.forget()
            check.forget()
            python.ability.cache_clear()
            engine_ability.forget()
            training_device.forget()
        self.report({"INFO"}, f"The engine is removed: {freed / 1e6:,.0f} MB freed")
        return {"FINISHED"}


_register, _unregister = registration(SetUpEngine, StopSetUp, CheckEngine, RemoveEngine)


def register() -> None:
    """Register the classes."""
    _register()


def unregister() -> None:
    """Unregister the classes; an installation that runs is ended."""
    timer.stop()
    training_device.timer.stop()
    graphics_card.timer.stop()
    install.forget()
    check.forget()
    _unregister()
