"""The engine job that is running; there is at most one.

In a window a timer polls it, and the window stays free. In a script or in background mode, Blender
calls no timers, so the caller waits for the same job.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import bpy

from ..blender import is_rendering, persistent
from ..engine.command import Engine
from ..engine.process import JobResult
from ..errors import AddonError
from ..windows import Timer, redraw, redraw_sidebars
from . import terminal, undo
from .job import Job
from .spec import TRAINING, JobSpec, nothing
from .state import JobState

POLL_SECONDS = 0.15
STOP_SECONDS = 10.0
"""Seconds after which a stopping engine is ended by force, when Blender cannot wait."""

job: Job | None = None
"""The running job, or else the last one."""

_training: Job | None = None
"""The last training. Its warnings stay useful until the next one, as for selecting photos."""

on_end: list[Callable[[], None]] = []
"""Called when a job has ended and its results are in."""

_no_job = JobState()


def busy() -> bool:
    """Whether a job is running."""
    return job is not None and not job.finished


def state() -> JobState:
    """The state of the running job, or of the last one."""
    return _no_job if job is None else job.state


def warnings(title: str) -> list[str]:
    """Return the warnings of the job with this title; a training's stay until the next one."""
    found = (one.state for one in (job, _training) if one is not None)
    return next((state.warnings for state in found if state.title == title), [])


def device() -> str:
    """Device of the last training, and the reason; empty if it is not known."""
    return _training.state.device if _training is not None else ""


def warn(text: str) -> None:
    """Warn about the results of the ending job, in its panel and in a terminal."""
    if job is not None:
        job.warn(text)


def stopped() -> bool:
    """Whether the last job was stopped."""
    return job is not None and job.result is not None and job.result.stopped


def outcome() -> str:
    """Outcome of the last job; empty if an undo has reverted it."""
    return job.state.outcome if job is not None and job.spec.is_so() else ""


def start(engine: Engine, spec: JobSpec) -> Job:
    """Start a job; in a window, also the timer that polls it.

    Raises:
        AddonError: a job is running already, or this one could not be started.
    """
    global job, _training
    if busy():
        raise AddonError("The engine is busy. Wait for it, or stop it first.")
    job = Job(engine, spec, on_end=_ended)
    if spec.title == TRAINING:
        _training = job
    if not bpy.app.background:
        timer.start()
    return job


def wait(job: Job) -> JobResult:
    """Follow a job to its end; in background mode, with its progress on standard error.

    In background mode, Ctrl-C and SIGTERM stop the engine. It writes a checkpoint, and the result
    is that of a stopped job. A second signal ends the engine at once and raises KeyboardInterrupt.
    """
    if not bpy.app.background:
        while job.poll():
            time.sleep(POLL_SECONDS)
        return _result(job)
    screen = terminal.Terminal(sys.stderr)
    try:
        with terminal.stopping(job.stop):
            running = True
            while running:
                running = job.poll()
                while job.messages:
                    screen.line(job.messages.popleft())
                if running:
                    screen.show(job.state.in_words(), topic=job.state.stage or job.state.title)
                    time.sleep(POLL_SECONDS)
    except KeyboardInterrupt:
        job.end_by_force(STOP_SECONDS)
        raise
    finally:
        screen.close()
    return _result(job)


def _result(job: Job) -> JobResult:
    assert job.result is not None
    return job.result


def _ended(job: Job) -> None:
    result = _result(job)
    take = job.spec.on_done if result.complete else job.spec.on_stop
    if job.spec.changes and take is not nothing:
        undo.push(job.spec.title)
    for listener in on_end:
        listener()


def _poll() -> bool:
    if job is None:
        return False
    running = job.poll(rendering=is_rendering())
    if not running:
        redraw()
    elif job.news:  # 3D views are slow to draw and have not changed, so only redraw sidebars
        redraw_sidebars()
    job.news = False
    return running


timer = Timer(_poll, POLL_SECONDS, persistent=True)
"""Follows the job in a window."""


@persistent
def _after_load(*_: object) -> None:
    """Forget ended jobs, which belong to another file. Loading has also ended the Esc operator."""
    global job, _training
    if job is not None:
        job.hears_esc = False
        if job.finished:
            job = None
    if _training is not job:
        _training = None


def register() -> None:
    """Add the handler. The timer only runs during a job."""
    bpy.app.handlers.load_post.append(_after_load)


def unregister() -> None:
    """Remove the handler and end a running job; its checkpoint stays."""
    global job, _training
    if _after_load in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_after_load)
    timer.stop()
    if job is not None and not job.finished:
        job.process.stop()
        if not job.process.wait(STOP_SECONDS):
            job.process.kill()
    job = _training = None
