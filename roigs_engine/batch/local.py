"""Runs parts as processes on this machine, as many as its cores and memory allow."""

from __future__ import annotations

import queue
import threading

from ..context import Context
from ..formats.events import Record
from ..formats.text import first_line
from ..machine import machine_memory, usable_cores
from .engine_process import LOST, Outcome
from .parts import Part
from .staged import run_part

Report = tuple[Part, "Record | Outcome"]
SPARE = 2  # default cores per part; on more cores, more parts run at a time


def default_jobs(device: str) -> int:
    """Default number of parts at a time: one for every `SPARE` cores; one on a GPU."""
    return 1 if device != "cpu" else max(1, usable_cores() // SPARE)


class LocalExecutor:
    """Runs parts on this machine, at most `jobs` at a time."""

    def __init__(self, jobs: int, context: Context) -> None:
        self._jobs, self._context = jobs, context
        self._running: dict[tuple[str, str], Part] = {}
        self._reports: queue.SimpleQueue[Report] = queue.SimpleQueue()

    def has_capacity(self, part: Part, avoid: tuple[str, ...] = ()) -> bool:
        """Whether the part can start now, not on `avoid`; a part that is too large runs alone."""
        if not self._running:
            return True
        taken = sum(other.memory for other in self._running.values())
        return len(self._running) < self._jobs and taken + part.memory <= machine_memory()

    def start(self, part: Part, waiting: int, avoid: tuple[str, ...] = ()) -> int:
        """Start a part; returns the number of cores that it gets.

        Args:
            waiting: number of other parts that could start now; with few, each gets more cores.
            avoid: nodes where it failed; here there is only one node.
        """
        self._running[part.key] = part
        at_a_time = max(len(self._running), min(self._jobs, len(self._running) + waiting))
        threads = max(1, usable_cores() // at_a_time)
        work = threading.Thread(target=self._run, args=(part, threads), daemon=True)
        work.start()
        return threads

    def wait(self, seconds: float) -> list[Report]:
        """Reports since the last call; waits for at most some seconds."""
        reports: list[Report] = []
        try:
            reports.append(self._reports.get(timeout=seconds))
            while True:
                reports.append(self._reports.get_nowait())
        except queue.Empty:
            pass
        for part, report in reports:
            if isinstance(report, Outcome):
                self._running.pop(part.key, None)
        return reports

    def can_move(self, avoid: tuple[str, ...]) -> bool:
        """Whether a failed part can be moved to another machine."""
        return False

    def stop(self, part: Part) -> None:
        """Ask one part to stop; does nothing here, because parts cannot move."""

    def close(self) -> None:
        """Do nothing: all parts have ended before."""

    def _run(self, part: Part, threads: int) -> None:
        def emit(event: Record) -> None:
            self._reports.put((part, event))

        try:
            outcome = run_part(part, threads, emit, self._context.should_stop)
        except Exception as error:  # without an outcome, the batch would wait forever
            reason = f"The engine cannot be started ({first_line(error):.200})."
            outcome = Outcome(state=LOST, reason=reason)
        self._reports.put((part, outcome))
