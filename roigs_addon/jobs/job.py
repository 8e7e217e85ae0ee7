"""A running job: the engine's events update its state; at its end, it takes results. No bpy."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..engine.command import Engine
from ..engine.event_log import DEVICE
from ..engine.process import EngineProcess, JobResult
from ..errors import AddonError
from ..shared import EngineError, events, files
from .spec import JobSpec, how_to_resume, nothing
from .state import STOPPED, STOPPING, WAITING, JobState


class Job:
    """A running engine command with its state; another command may follow it in the same job.

    Attributes:
        spec: of the running command.
        process: the engine.
        state: for the panel.
        result: of the job; None while it runs.
        stopping: whether it was asked to stop.
        hears_esc: whether an operator runs that stops it at Esc. There is none after the file
            browser, or after a file was loaded: that ends the operator but not the job.
        news: whether anything has changed since the panel was last drawn. Code that redraws the
            panel clears it.
        messages: for the user, not shown yet.
    """

    def __init__(
        self, engine: Engine, spec: JobSpec, *, on_end: Callable[[Job], None] = nothing
    ) -> None:
        """Start the command; `on_end` is called when it has ended and its results are taken.

        Raises:
            AddonError: the engine's Python could not be started.
        """
        self.spec = spec
        self.state = JobState(title=spec.title, log=spec.log)
        self.result: JobResult | None = None
        self.stopping = False
        self.hears_esc = False
        self.news = True
        self.messages: deque[str] = deque(maxlen=100)
        self._on_end = on_end
        self._preview: Path | None = None
        self._engine = engine
        self.process = _started(engine, spec)

    @property
    def finished(self) -> bool:
        """Whether the job has ended and its results are taken."""
        return self.result is not None

    def poll(self, *, rendering: bool = False) -> bool:
        """Take new events; return False once the job has ended and its results are taken.

        Args:
            rendering: Blender is rendering, and would crash if its data changed. Previews and
                results then wait for a later call; a failure does not.
        """
        running = self.process.running()
        for event in self.process.events():
            self._take(event)
            self.news = True
        result = None if running or self.finished else self.process.result()
        brings = result is None or result.complete or self.spec.on_stop is not nothing
        if rendering and not self.finished and brings:
            if result is not None and self.state.message != WAITING:
                self.state.message, self.news = WAITING, True
            return True
        # While it stops, the engine writes a last preview and a checkpoint. Drawing the preview
        # now would delay this.
        if self._preview is not None and not (rendering or (running and self.stopping)):
            _guarded(partial(self.spec.on_preview, self._preview))
            self._preview = None
        if result is not None:
            self._finish(result)
        return not self.finished

    def stop(self) -> None:
        """Ask the engine to stop."""
        self.stopping = self.news = True
        self.state.message = STOPPING
        self.process.stop()

    def warn(self, text: str) -> None:
        """Add a warning about the results, before the engine's warnings."""
        self.state.warnings.insert(0, text)
        self.messages.append(text)
        self.news = True

    def end_by_force(self, seconds: float) -> None:
        """End the engine at once, and wait for its end."""
        self.process.kill()
        self.process.wait(seconds)

    def _take(self, event: events.Record) -> None:
        self.state.take(event)
        if event["event"] == "message":
            self.messages.append(event.get("text", ""))
        elif event["event"] == "device":
            self.messages.append(f"{DEVICE}{self.state.device}")
        elif event["event"] == "preview":
            path = Path(event.get("path", ""))
            if _is_file_in(self.spec.folder, path):
                self._preview = path

    def _finish(self, result: JobResult) -> None:
        if self.stopping and self.spec.then and not result.failed:
            result = replace(result, stopped=True)  # the job was stopped, though not this command
        self.result = result
        if result.complete:
            self.state.message = ""
            error = _guarded(partial(self._go_on, result.outputs))
            if not self.finished:
                return
            result = replace(result, message=error)
        elif error := _guarded(self.spec.on_stop):
            self.warn(error)
        self._end(result)

    def _go_on(self, outputs: Mapping[str, str]) -> None:
        """Start the next command of the job; if there is none, take the results."""
        following = self.spec.then(outputs) if self.spec.then else None
        if following is None:
            said = self.spec.on_done()
            self.spec = replace(self.spec, done_text=said or self.spec.done_text)
            return
        self.process = _started(self._engine, following)
        self.spec, self.result = following, None
        before = self.state
        self.state = JobState(
            title=following.title,
            log=following.log,
            warnings=before.warnings,
            device=before.device,
        )

    def _end(self, result: JobResult) -> None:
        for option, name in self.spec.words.items():
            result = replace(result, message=result.message.replace(option, name))
        resume = how_to_resume(self.spec.title)
        if result.killed:
            result = replace(result, message=result.message + resume)
        self.result = result
        if result.stopped:
            self.state.message = STOPPED + resume
        elif not result.failed:
            self.state.outcome = self.spec.done_text
        self.state.error = result.message
        self.state.stage = ""
        self._on_end(self)


def _started(engine: Engine, spec: JobSpec) -> EngineProcess:
    """Start the engine process of a job."""
    if spec.log is not None and files.is_link(spec.log.parent):
        raise AddonError(f"{spec.log.parent} is a link; nothing is written through links.")
    try:
        return EngineProcess(engine, spec.arguments, log=spec.log)
    except (OSError, EngineError) as error:
        raise AddonError(
            f"The engine's Python cannot be started ({error}). See the add-on's preferences."
        ) from error


def _is_file_in(folder: Path | None, path: Path) -> bool:
    """Whether the file exists inside the folder, after links are followed."""
    try:
        return (
            folder is not None
            and path.is_file()
            and path.resolve().is_relative_to(folder.resolve())
        )
    except (OSError, ValueError, RuntimeError):  # name too long, a NUL in it, circular links
        return False


def _guarded(callback: Callable[[], None]) -> str:
    """Call it; return its error for the panel. An exception would end the timer silently."""
    try:
        callback()
    except AddonError as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return f"Blender could not import the result: {error}"
    return ""
