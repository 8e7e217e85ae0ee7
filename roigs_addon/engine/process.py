"""One engine command as a child process: starts it, reads its events, stops it. No bpy.

The engine writes one JSON line per event to its standard output (`shared.events`) and text for
users to standard error. It stops when its standard input ends, so no engine outlives Blender.
Threads only put events into a queue; the owner takes them out on Blender's main thread.
"""

from __future__ import annotations

import queue
import subprocess
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from ..shared import events, files
from . import environments
from .command import HIDDEN, Engine
from .event_log import in_words, read_lines

MAX_WAITING = 10_000  # events in the queue: further ones are dropped, except the final one
KEPT_LINES = 200
LOG_SECONDS = 10.0
"""Least time between two progress lines in the log."""
STOPPED = 3
"""Exit status of a command that stopped on request (docs/files.md)."""


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """The end of a job: its last event, or a message if there is none.

    Attributes:
        status: the process's exit status.
        outputs: name -> path of each file made.
        stopped: whether it stopped on request.
        message: the error; empty if there is none.
    """

    status: int
    outputs: dict[str, str] = field(default_factory=dict)
    stopped: bool = False
    message: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is an error to show."""
        return bool(self.message)

    @property
    def complete(self) -> bool:
        """Whether it finished all its work, so that its outputs are valid."""
        return not self.stopped and not self.failed

    @property
    def killed(self) -> bool:
        """Whether a signal has ended the engine."""
        return self.status < 0


class EngineProcess:
    """A running engine command. Only the owner's thread may call its methods."""

    def __init__(
        self, engine: Engine, arguments: Sequence[str], *, log: Path | None = None
    ) -> None:
        """Start the command; `arguments` begin with its name, and `--events` is added.

        Raises:
            OSError: the Python could not be started.
        """
        with ExitStack() as stack:
            stack.enter_context(environments.using(engine.python))
            self._start(engine, arguments, log)
            self._used = stack.pop_all()
        for reader in self._readers:
            reader.start()

    def _start(self, engine: Engine, arguments: Sequence[str], log: Path | None) -> None:
        self._events: queue.SimpleQueue[events.Record] = queue.SimpleQueue()
        self._final: events.Record | None = None
        self._log = _Log(log)
        self._log.write(f"{time.strftime('%Y-%m-%d')} roigs_engine {' '.join(arguments)}")
        self._process = subprocess.Popen(
            engine.command([*arguments, "--events"]),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=engine.environment(),
            text=True,
            encoding="utf-8",
            errors="replace",
            bufsize=1,
            creationflags=HIDDEN,
        )
        self._readers = [
            threading.Thread(target=self._read_to_the_end, daemon=True),
            threading.Thread(target=self._read_text, daemon=True),
        ]

    @property
    def pid(self) -> int:
        """Return the process ID."""
        return int(self._process.pid)

    def events(self) -> list[events.Record]:
        """Return the events since the last call, in order, without the final event."""
        arrived: list[events.Record] = []
        while True:
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                return arrived
            if event["event"] in events.FINAL:
                self._final = event
            else:
                arrived.append(event)

    def running(self) -> bool:
        """Whether the process is alive or some of its output is still unread."""
        return self._process.poll() is None or any(r.is_alive() for r in self._readers)

    def stop(self) -> None:
        """Ask it to stop by closing its input; it writes a checkpoint and then ends.

        Nothing is written to the pipe: if the engine has already ended, SIGPIPE would kill some
        builds of Blender.
        """
        assert self._process.stdin is not None
        self._process.stdin.close()

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end; return False after `timeout` seconds."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        for reader in self._readers:
            reader.join(5.0)
        return True

    def result(self) -> JobResult:
        """Return the result. Call this only once `running` is False."""
        self.events()
        self.stop()  # closes the pipe
        self._log.close()
        status, final = self._process.wait(), self._final
        if final is not None and final["event"] == "done":
            stopped = final.get("stopped", False) or status == STOPPED
            return JobResult(status=status, outputs=final.get("outputs", {}), stopped=stopped)
        if final is not None:
            parts = (final.get("message") or "The engine failed.", final.get("hint", ""))
            return JobResult(status=status, message=" ".join(p for p in parts if p))
        return JobResult(status=status, message=self._unexplained(status))

    def _unexplained(self, status: int) -> str:
        """Return an error message if the engine ended without one."""
        if status < 0:
            return f"The engine was ended from outside (signal {-status})."
        last = next((line for line in reversed(self._log.said) if line.strip()), "")
        reason = f": {last.strip()}" if last else ""
        return f"The engine ended with status {status}{reason}. See the log for more."

    def _read_to_the_end(self) -> None:
        with self._used:
            self._read_events()

    def _read_events(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in read_lines(output):
                event = events.parse_event(line)
                if event is None:
                    self._log.note(line)
                    continue
                if event["event"] in events.FINAL or self._events.qsize() < MAX_WAITING:
                    self._events.put(event)
                self._log.take(event)

    def _read_text(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as text:
            for line in read_lines(text):
                self._log.note(line)


class _Log:
    """The log file of a process, if any, and the engine's last lines for the user."""

    def __init__(self, path: Path | None) -> None:
        self.said: deque[str] = deque(maxlen=KEPT_LINES)
        self._shown = -LOG_SECONDS
        self._file: IO[str] | None = None
        if path is not None:
            self._file = files.open_log(path)

    def take(self, event: events.Record) -> None:
        """Write an event in words; of progress, only a line every `LOG_SECONDS`."""
        if event["event"] == "progress":
            now = time.monotonic()
            if now - self._shown < LOG_SECONDS:
                return
            self._shown = now
        self.write(in_words(event))

    def note(self, line: str) -> None:
        """Write and keep one line for the user."""
        self.said.append(line.rstrip("\n"))
        self.write(line.rstrip("\n"))

    def write(self, text: str) -> None:
        """Write a line with the time of day."""
        log = self._file
        if log is not None and text:
            try:
                log.write(f"{time.strftime('%H:%M:%S')}  {text}\n")
                log.flush()
            except (OSError, ValueError):  # the disk is full, or the process has been closed
                pass

    def close(self) -> None:
        """Close the log file."""
        if self._file is not None:
            self._file.close()
            self._file = None
