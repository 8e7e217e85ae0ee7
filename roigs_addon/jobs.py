"""The one engine job that runs at a time: events into properties, its end into results.

In a window, a timer takes the events and the window stays free. In a script or in the background,
where no timer runs, the same job is waited for.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import terminal, undo
from .engine.client import Engine, Job, Outcome
from .errors import AddonError

POLL_SECONDS = 0.15
STOPPING = "Stopping …"
STOP_SECONDS = 10.0
"""How long a stopping engine may take before it is ended by force, when Blender cannot wait."""


def nothing(*_: Any) -> None:
    """The default for callbacks."""


@dataclass(frozen=True, kw_only=True)
class Work:
    """What to run and what to do with it.

    Attributes:
        title: what the panel calls it.
        arguments: the engine's command line, beginning with the command.
        log: where the engine's text goes.
        folder: of the run; previews that lie elsewhere are not looked at.
        on_preview: called with the path of each preview.
        on_done: called with the outcome of a job that was done, not stopped; may raise AddonError.
    """

    title: str
    arguments: list[str]
    log: Path
    folder: Path | None = None
    on_preview: Callable[[Path], None] = nothing
    on_done: Callable[[Outcome], None] = nothing


class Runner:
    """A job with its work."""

    def __init__(self, engine: Engine, work: Work) -> None:
        """Start it.

        Raises:
            AddonError: the engine's Python could not be started.
        """
        self.work = work
        self.stopping = False
        self.finished = False
        self.hears_esc = False
        """Whether an operator is there that stops it at Esc: none is after the file browser, or
        after a file was loaded, which ends the operator and not the job."""
        self.news = True
        """Whether anything came since the panel was last drawn; whoever draws it clears this."""
        self._preview: Path | None = None
        self.messages: deque[str] = deque(maxlen=100)
        self._latest: dict[str, dict[str, Any]] = {}
        self.show()
        try:
            self.job = Job(engine, work.arguments, log=work.log)
        except OSError as error:
            raise AddonError(
                f"The engine's Python cannot be started ({error}). See the add-on's preferences."
            ) from error

    def poll(self) -> bool:
        """Take what has arrived; False when the job has ended and its results are in."""
        running = self.job.running()
        for event in self.job.events():
            self._take(event)
            self.news = True
        # A stopping engine writes a last one and its checkpoint: to draw it now would hold that up.
        if self._preview is not None and not (running and self.stopping):
            _guarded(self.work.on_preview, self._preview)
            self._preview = None
            redraw()
        if not running and not self.finished:
            self.finished = True
            self._finish()
        return running

    def stop(self) -> None:
        """Ask the engine to stop."""
        self.stopping = self.news = True
        bpy.context.window_manager.roigs.message = STOPPING
        self.job.stop()

    def show(self) -> None:
        """Set the properties afresh, from the latest event of each kind."""
        state = bpy.context.window_manager.roigs
        state.title, state.stage, state.message, state.error = self.work.title, "", "", ""
        state.step = state.total = state.gaussians = 0
        state.seconds_left = state.loss = state.psnr = 0.0
        state.log = str(self.work.log)
        for event in self._latest.values():
            self._show(event)
        if self.stopping:
            state.message = STOPPING

    def _take(self, event: dict[str, Any]) -> None:
        kind = event["event"]
        self._latest.pop(kind, None)  # the newest last
        self._latest[kind] = event
        self._show(event)
        if kind == "message":
            self.messages.append(event.get("text", ""))
        elif kind == "preview":
            path = Path(event.get("path", ""))
            if _is_file_in(self.work.folder, path):
                self._preview = path

    def _show(self, event: dict[str, Any]) -> None:
        state = bpy.context.window_manager.roigs
        match event["event"]:
            case "stagestarted":
                state.stage, state.total = event.get("stage", ""), event.get("total", 0)
                state.step = 0
            case "progress":
                state.stage = event.get("stage", "")
                state.step, state.total = event.get("step", 0), event.get("total", 0)
                state.loss, state.psnr = event.get("loss", 0.0), event.get("psnr", 0.0)
                state.gaussians = event.get("gaussians", 0)
                state.seconds_left = event.get("seconds_left", 0.0)
            case "message":
                state.message = event.get("text", "")

    def _finish(self) -> None:
        state = bpy.context.window_manager.roigs
        self.outcome = self.job.outcome()
        if self.outcome.stopped:
            state.message = "Stopped: «Continue» goes on."
        elif not self.outcome.failed:
            state.message = ""
            self.outcome.message = _guarded(self.work.on_done, self.outcome)
            if not self.outcome.message:
                undo.push(self.work.title)
        state.error = self.outcome.message
        state.stage = ""
        for listener in on_end:
            listener()


def _is_file_in(folder: Path | None, path: Path) -> bool:
    """Whether the file is there, inside the folder; links are followed first."""
    try:
        return (
            folder is not None
            and path.is_file()
            and path.resolve().is_relative_to(folder.resolve())
        )
    except (OSError, ValueError, RuntimeError):  # a name too long, a NUL in it, links in a circle
        return False


def _guarded(callback: Callable[[Any], None], value: Any) -> str:
    """Call it; what went wrong, for the panel. An exception would end the timer without a word."""
    try:
        callback(value)
    except AddonError as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return f"Blender could not take this in: {error}"
    return ""


current: Runner | None = None
on_end: list[Callable[[], None]] = []
"""Called when a job has ended and its results are in."""


def busy() -> bool:
    """Whether a job is running."""
    return current is not None and not current.finished


def start(engine: Engine, work: Work) -> Runner:
    """Start a job; in a window, the timer that follows it too.

    Raises:
        AddonError: one is running already, or this one could not be started.
    """
    global current
    if busy():
        raise AddonError("The engine is busy. Wait for it, or stop it first.")
    current = Runner(engine, work)
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=POLL_SECONDS, persistent=True)
    return current


def wait(runner: Runner) -> Outcome:
    """Follow a job to its end, in the background with its progress on standard error.

    There, Ctrl-C and SIGTERM stop the engine, which writes a checkpoint, and the outcome is that of
    a stopped job. A second one ends the engine at once and raises KeyboardInterrupt.
    """
    if not bpy.app.background:
        while runner.poll():
            time.sleep(POLL_SECONDS)
        return runner.outcome
    state = bpy.context.window_manager.roigs
    screen = terminal.Terminal(sys.stderr)
    try:
        with terminal.stopping(runner.stop):
            running = True
            while running:
                running = runner.poll()
                while runner.messages:
                    screen.line(runner.messages.popleft())
                if running:
                    screen.show(progress_text(state), topic=state.stage or state.title)
                    time.sleep(POLL_SECONDS)
    except KeyboardInterrupt:
        runner.job.kill()
        runner.job.wait(STOP_SECONDS)
        raise
    finally:
        screen.close()
    return runner.outcome


def progress_text(state: Any) -> str:
    """One line: where the job is."""
    if not state.stage:
        return state.title
    share = f" {state.step:,} / {state.total:,}" if state.total else ""
    quality = f", {state.psnr:.1f} dB" if state.psnr else ""
    size = f", {state.gaussians:,} Gaussians" if state.gaussians else ""
    return f"{state.stage}{share}{quality}{size}{time_text(state.seconds_left)}"


def time_text(seconds: float) -> str:
    """«, 2 min 05 s left», or nothing."""
    if seconds <= 0:
        return ""
    minutes, rest = divmod(round(seconds), 60)
    return f", {minutes} min {rest:02} s left" if minutes else f", {rest} s left"


def _tick() -> float | None:
    """Blender's timer: again in so many seconds, or never."""
    if current is None:
        return None
    running = current.poll()
    if not running:
        redraw()
    elif current.news:  # the pictures beside the sidebar take long to draw, and are as they were
        redraw_sidebars()
    current.news = False
    return POLL_SECONDS if running else None


def redraw(kind: str = "VIEW_3D") -> None:
    """Draw the areas of a kind again; by default the 3D views, with their sidebars."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == kind:
                area.tag_redraw()


def redraw_sidebars() -> None:
    """Draw the sidebars of the 3D views again, and nothing else."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


@persistent
def _after_load(*_: object) -> None:
    """A new window manager knows nothing of the job, and nobody listens to its keys."""
    if current is not None and not current.finished:
        current.hears_esc = False
        current.show()


def register() -> None:
    """Follow the file; the timer lives as long as a job."""
    bpy.app.handlers.load_post.append(_after_load)


def unregister() -> None:
    """End a running job; its checkpoint stays."""
    global current
    if _after_load in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_after_load)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    if current is not None and not current.finished:
        current.job.stop()
        if not current.job.wait(STOP_SECONDS):
            current.job.kill()
    current = None
