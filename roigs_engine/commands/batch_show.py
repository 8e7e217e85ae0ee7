"""A batch on the terminal, and for programs: what is planned, how far it is, how it ended."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..batch.board import Board, duration
from ..batch.engine_process import DONE, Outcome
from ..batch.makespan import makespan
from ..batch.moves import PartState
from ..batch.parts import WHOLE, ScenePlan
from ..batch.schedule import SceneState
from ..formats.events import Event, Message, Preview, Progress, Record, StageStarted
from ..formats.text import counted, in_gb, printable
from .console import Console

if TYPE_CHECKING:
    from collections.abc import Mapping

MACHINES = (1, 2, 5, 10)
EVERY = 1.0  # seconds between two pictures of the board
HEAD = ("scene", "objects", "stages", "steps", "memory", "minutes", "")


class Shown:
    """Shows a batch as it goes on: as events, as a board, or as lines where no terminal is.

    Args:
        console: of the command; asked to write.
        board: of the batch.
        json_lines: whether programs read along.
        alone: whether there is one scene, whose name need not be said.
    """

    def __init__(
        self, console: Console, board: Board, *, json_lines: bool, alone: bool = False
    ) -> None:
        self._console, self._board = console, board
        self._json, self._alone = json_lines, alone
        self._terminal = not json_lines and sys.stderr.isatty()
        self._drawn, self._last = 0, 0.0
        self._warned: set[tuple[str, str]] = set()  # the parts of a scene say the same

    def take(self, scene: SceneState, state: PartState, report: Record | Outcome) -> None:
        """Show what a part has told."""
        if isinstance(report, Outcome):
            self._ended(scene, state, report)
        elif report["event"] == "message" and report.get("level") == "warning":
            self._warn(self._named(scene), str(report.get("text", "")))
        elif self._json:
            self._pass_on(self._named(scene), report)
        self.draw()

    def message(self, event: Event) -> None:
        """Show a line above the board."""
        self._clear()
        self._console.emit(event)

    def draw(self, *, now: bool = False) -> None:
        """Draw the board anew, at most once a second."""
        if not self._terminal or (not now and time.monotonic() - self._last < EVERY):
            return
        self._clear()
        width = shutil.get_terminal_size().columns - 1
        lines = [printable(line)[:width] for line in self._board.lines()]
        sys.stderr.write("".join(f"{line}\n" for line in lines))
        self._drawn, self._last = len(lines), time.monotonic()

    def _warn(self, scene: str, text: str) -> None:
        if (scene, text) not in self._warned:
            self._warned.add((scene, text))
            self.message(Message(text=f"{scene}{text}", level="warning"))

    def _named(self, scene: SceneState) -> str:
        """The beginning of texts about a scene."""
        return "" if self._alone else f"{scene.plan.name}: "

    def _ended(self, scene: SceneState, state: PartState, outcome: Outcome) -> None:
        if self._json and not self._alone:
            self._console.emit(self._board.event())
        elif not self._alone and outcome.state == DONE and scene.state == DONE:
            took = duration(sum(part.seconds for part in scene.parts.values()))
            self.message(Message(text=f"{scene.plan.name}: done in {took}. {self._board.head()}."))

    def _pass_on(self, scene: str, report: Record) -> None:
        """An engine's event, its stage named after its scene."""
        stage = f"{scene}{report.get('stage', '')}"
        match report["event"]:
            case "progress":
                values = {k: report.get(k, float("nan")) for k in ("loss", "psnr", "seconds_left")}
                counts = {k: int(report.get(k, 0)) for k in ("step", "total", "gaussians")}
                self._console.emit(Progress(stage=stage, **counts, **values))
            case "stagestarted":
                self._console.emit(StageStarted(stage=stage, total=int(report.get("total", 0))))
            case "message":
                self._console.emit(Message(text=f"{scene}{report.get('text', '')}"))
            case "preview":
                self._console.emit(Preview(path=str(report.get("path", ""))))

    def _clear(self) -> None:
        """Remove the board that is on the terminal."""
        if self._drawn:
            sys.stderr.write(f"\x1b[{self._drawn}A\x1b[J")
            self._drawn = 0


def plan_text(
    scenes: Sequence[ScenePlan], seconds: Mapping[tuple[str, str], float], measured: int
) -> str:
    """The plan of a batch: a row for each scene, and the time on so many machines.

    Args:
        scenes: their plans.
        seconds: of each part.
        measured: the number of stages that were timed.
    """
    rows = [HEAD, *(_row(scene, seconds) for scene in scenes)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
    lines = [
        "  ".join(
            cell.ljust(width) if column in (0, 6) else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    objects = sum(len(scene.objects) for scene in scenes)
    parts = [scene.parts for scene in scenes]
    times = ", ".join(f"{count}: {duration(makespan(parts, seconds, count))}" for count in MACHINES)
    unknown = [scene.name for scene in scenes if not scene.stages]
    notes = [
        f"{counted(objects, 'object')} in {counted(len(scenes), 'scene')},"
        f" {counted(sum(map(len, parts)), 'part')}.",
        f"Time on so many machines like this one, an estimate from {counted(measured, 'stage')}"
        f" of which a few steps were trained: {times}.",
    ]
    if unknown:
        notes.append(
            f"Not in it: {counted(len(unknown), 'scene')} of photos without a COLMAP model."
        )
    return "\n".join([*lines, "", *notes])


def _row(scene: ScenePlan, seconds: Mapping[tuple[str, str], float]) -> tuple[str, ...]:
    memory = max((part.memory for part in scene.parts), default=0)
    return (
        scene.name,
        str(len(scene.objects)),
        str(len(scene.stages)) if scene.stages else "?",
        f"{sum(stage.steps for stage in scene.stages):,}" if scene.stages else "?",
        in_gb(memory) if scene.stages else "?",
        f"{sum(seconds[part.key] for part in scene.parts) / 60:.1f}" if scene.stages else "?",
        "done" if scene.done else "" if WHOLE in {p.name for p in scene.parts} else "outputs",
    )
