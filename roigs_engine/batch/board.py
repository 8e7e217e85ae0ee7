"""Reports a batch's progress: finished objects, running parts with step and PSNR, time left."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from ..context import Context
from ..errors import Stopped
from ..formats.events import MAX_NUMBER, Board, Message, Preview, Progress, Record, StageStarted
from ..formats.text import counted, duration
from .engine_process import DONE, FAILED, Outcome
from .moves import RUNNING, PartState, share
from .schedule import SceneState

ENOUGH = 0.01  # the time left is shown after this share of the work
MOST_LINES = 12  # lines for running parts
BATCH_STAGE = "batch"
EVERY = 1.0  # seconds between two updates of the board


class Reporter:
    """Turns parts' reports into events while a batch runs; use it in a `with` block.

    A program gets the parts' events, with the scene's name before the stage's. A person gets the
    board, a line for each finished scene, and warnings.

    Args:
        scenes: their states, by name.
        context: receives the events.
        alone: whether there is only one scene; its name is then left out.
    """

    def __init__(
        self, scenes: Mapping[str, SceneState], context: Context, *, alone: bool = False
    ) -> None:
        self._scenes, self._context, self._alone = scenes, context, alone
        self._started, self._before = time.monotonic(), self._work_done()
        self._last = 0.0
        self._warned: set[tuple[str, str]] = set()  # because parts of a scene repeat warnings

    def __enter__(self) -> Reporter:
        """Report the batch's present progress."""
        if not self._alone:
            self._context.info(f"{self.head()}.")
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Show the board a last time; a stopped batch can be resumed."""
        self._draw(now=True)
        if isinstance(error, Stopped):
            error.resumes = True

    def take(self, scene: SceneState, state: PartState, report: Record | Outcome) -> None:
        """Forward a part's report."""
        name = "" if self._alone else f"{scene.plan.name}: "
        if isinstance(report, Outcome):
            if not self._alone:
                self._ended(scene, report)
        elif report["event"] == "message" and report.get("level") == "warning":
            text = str(report.get("text", ""))
            if (name, text) not in self._warned:
                self._warned.add((name, text))
                self._context.warn(f"{name}{text}")
        elif not self._context.for_person:
            self._pass_on(name, report)
        self._draw()

    def _draw(self, *, now: bool = False) -> None:
        if self._context.for_person and (now or time.monotonic() - self._last >= EVERY):
            self._context.emit(Board(lines=tuple(self.lines())))
            self._last = time.monotonic()

    def _ended(self, scene: SceneState, outcome: Outcome) -> None:
        if not self._context.for_person:
            event = Progress(
                stage=BATCH_STAGE,
                step=self.objects(DONE),
                total=self.objects(),
                loss=math.nan,
                psnr=math.nan,
                gaussians=0,
                seconds_left=min(self.seconds_left(), MAX_NUMBER - 1.0),
            )
            self._context.emit(event)
        elif outcome.state == DONE and scene.state == DONE:
            took = duration(sum(part.seconds for part in scene.parts.values()))
            self._context.info(f"{scene.plan.name}: done in {took}. {self.head()}.")

    def _pass_on(self, scene: str, report: Record) -> None:
        """Forward an engine's event, with the scene's name before the stage's."""
        stage, emit = f"{scene}{report.get('stage', '')}", self._context.emit
        match report["event"]:
            case "progress":
                values = {k: report.get(k, math.nan) for k in ("loss", "psnr", "seconds_left")}
                counts = {k: int(report.get(k, 0)) for k in ("step", "total", "gaussians")}
                emit(Progress(stage=stage, **counts, **values))
            case "stagestarted":
                emit(StageStarted(stage=stage, total=int(report.get("total", 0))))
            case "message":
                emit(Message(text=f"{scene}{report.get('text', '')}"))
            case "preview":
                emit(Preview(path=str(report.get("path", ""))))

    def objects(self, state: str | None = None) -> int:
        """The number of objects, or of those in scenes of that state."""
        scenes = (s for s in self._scenes.values() if state in (None, s.state))
        return sum(len(scene.plan.objects) for scene in scenes)

    def seconds_left(self) -> float:
        """Seconds left, from the work done since the start; NaN: too little was done."""
        whole = sum(scene.plan.work for scene in self._scenes.values() if not scene.reason)
        done = self._work_done()
        fresh, elapsed = done - self._before, time.monotonic() - self._started
        if fresh <= ENOUGH * (whole - self._before) or whole <= 0:
            return math.nan
        return max(0.0, whole - done) * elapsed / fresh

    def head(self) -> str:
        """One line on objects and time."""
        failed = self.objects(FAILED)
        words = [
            f"{self.objects(DONE)} of {counted(self.objects(), 'object')} done",
            f"{self.objects(RUNNING)} running",
            *([f"{failed} failed"] if failed else []),
        ]
        left = self.seconds_left()
        if left > 0:  # parts that write `outputs` count as no work
            words.append(f"about {duration(left)} left")
        return ", ".join(words)

    def lines(self) -> list[str]:
        """The head, and a line for each running part."""
        running = [
            self._line(part)
            for scene in self._scenes.values()
            for part in scene.parts.values()
            if part.state == RUNNING
        ]
        more = len(running) - MOST_LINES
        rest = [f"  and {counted(more, 'more part')}"] if more > 0 else []
        return [self.head(), *running[:MOST_LINES], *rest]

    def _line(self, state: PartState) -> str:
        words = [f"  {state.part.label}"]
        last = state.progress
        if last.get("stage"):
            words.append(str(last["stage"]))
        if last.get("total") and "step" in last:
            words.append(f"step {last['step']:,} of {last['total']:,}")
        if "psnr" in last:
            words.append(f"{last['psnr']:.2f} dB")
        return "  ".join(words)

    def _work_done(self) -> float:
        parts = [p for s in self._scenes.values() if not s.reason for p in s.parts.values()]
        return sum(share(part) * part.part.work for part in parts)
