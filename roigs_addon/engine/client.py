"""One run of the engine: started, listened to, stopped. No bpy.

The engine writes one JSON line per event on its standard output (docs/files.md, «Events»), text
for people on standard error, and stops when its standard input says so or ends; the end of input
also covers the death of Blender, so that no engine outlives it. Threads only queue what arrives;
whoever owns the job takes it from the queue, on Blender's main thread.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

FIELDS: dict[str, dict[str, type]] = {
    "stagestarted": {"stage": str, "total": int},
    "progress": {
        "stage": str,
        "step": int,
        "total": int,
        "gaussians": int,
        "loss": float,
        "psnr": float,
        "seconds_left": float,
    },
    "message": {"text": str, "level": str},
    "preview": {"path": str},
    "done": {"outputs": dict, "stopped": bool},
    "failed": {"message": str, "hint": str},
}
"""What the events carry (docs/files.md); all else that a line may hold is passed over."""
MAX_NUMBER = 1 << 31  # Blender's integers hold less
MAX_LINE = 1 << 16  # letters; a longer line is no event
MAX_WAITING = 10_000  # events that nobody has taken: further ones are dropped, but for the last
FINAL = ("done", "failed")
KEPT_LINES = 200
LOG_SECONDS = 10.0
"""Least time between two lines of the log that tell of progress."""

SHOWN = ("loss", "psnr", "gaussians")
STOPPED = 3
"""Exit status of a command that stopped on request (docs/files.md)."""


def without_blender(variables: Mapping[str, str]) -> dict[str, str]:
    """Environment variables without what would lead another Python to Blender's packages."""
    return {k: v for k, v in variables.items() if k not in ("PYTHONHOME", "PYTHONPATH")}


@dataclass(frozen=True, kw_only=True)
class Engine:
    """How to start it: the Python that runs it and the folder that holds `roigs_engine`."""

    python: Path
    source: Path

    def command(self, arguments: Sequence[str]) -> list[str]:
        """The full command line of one engine command."""
        return [str(self.python), "-m", "roigs_engine", *arguments]

    def environment(self) -> dict[str, str]:
        """This process's variables, without what belongs to Blender's own Python."""
        return without_blender(os.environ) | {
            "PYTHONPATH": str(self.source),
            "PYTHONSAFEPATH": "1",  # no modules out of the folder that Blender was started in
            "PYTHONUNBUFFERED": "1",
            "PYTHONUTF8": "1",
            "PYTHONNOUSERSITE": "1",
        }


@dataclass
class Outcome:
    """How a job ended: what the last event said, or what can be said without one."""

    status: int
    outputs: dict[str, str] = field(default_factory=dict)
    stopped: bool = False
    message: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is an error to show."""
        return bool(self.message)


class Job:
    """A running engine command. All methods are for one thread, the owner's."""

    def __init__(
        self,
        engine: Engine,
        arguments: Sequence[str],
        *,
        log: Path | None = None,
        extra_environment: Mapping[str, str] | None = None,
    ) -> None:
        """Start it; `arguments` begin with the command and `--events` is added.

        Raises:
            OSError: the Python could not be started.
        """
        self._events: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._said: deque[str] = deque(maxlen=KEPT_LINES)
        self._final: dict[str, Any] | None = None
        self._logged = -LOG_SECONDS
        self.log = log
        self._log_file: IO[str] | None = None
        if log is not None:
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log_file = log.open("a", encoding="utf-8")
            self._write(f"{time.strftime('%Y-%m-%d')} roigs_engine {' '.join(arguments)}")
        hidden = {"creationflags": 0x08000000} if os.name == "nt" else {}  # CREATE_NO_WINDOW
        self._process = subprocess.Popen(
            engine.command([*arguments, "--events"]),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=engine.environment() | dict(extra_environment or {}),
            text=True,
            encoding="utf-8",
            errors="replace",
            bufsize=1,
            **hidden,
        )
        self._readers = [
            threading.Thread(target=self._read_events, daemon=True),
            threading.Thread(target=self._read_text, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        """Of the engine's process."""
        return self._process.pid

    def events(self) -> list[dict[str, Any]]:
        """What has arrived since the last call, in order; the last event of a job is kept back."""
        arrived = []
        while True:
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                return arrived
            if event["event"] in FINAL:
                self._final = event
            else:
                arrived.append(event)

    def running(self) -> bool:
        """Whether the process lives or its last lines are still to be read."""
        return self._process.poll() is None or any(r.is_alive() for r in self._readers)

    def stop(self) -> None:
        """Ask it to stop, by the end of its input; it writes a checkpoint first and then ends.

        Nothing is written there: a signal would end Blender when the engine is gone already, for
        some builds do not ignore SIGPIPE.
        """
        assert self._process.stdin is not None
        self._process.stdin.close()

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end; False when that took longer than `timeout` seconds."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        for reader in self._readers:
            reader.join(5.0)
        return True

    def outcome(self) -> Outcome:
        """How it ended; call once `running` is False."""
        self.events()
        self.stop()  # closes the pipe
        if self._log_file is not None:
            self._log_file.close()
            self._log_file = None
        status, final = self._process.wait(), self._final
        if final is not None and final["event"] == "done":
            stopped = final.get("stopped", False) or status == STOPPED
            return Outcome(status=status, outputs=final.get("outputs", {}), stopped=stopped)
        if final is not None:
            parts = (final.get("message") or "The engine failed.", final.get("hint", ""))
            return Outcome(status=status, message=" ".join(p for p in parts if p))
        return Outcome(status=status, message=self._unexplained(status))

    def _unexplained(self, status: int) -> str:
        """What to say when the engine ended without its own words."""
        if status < 0:
            return f"The engine was ended from outside (signal {-status}). «Continue» goes on."
        last = next((line for line in reversed(self._said) if line.strip()), "")
        reason = f": {last.strip()}" if last else ""
        return f"The engine ended with status {status}{reason}. The log has more."

    def _read_events(self) -> None:
        assert self._process.stdout is not None
        for line in _lines(self._process.stdout):
            event = parse_event(line)
            if event is None:
                self._note(line)
                continue
            if event["event"] in FINAL or self._events.qsize() < MAX_WAITING:
                self._events.put(event)
            if event["event"] == "progress":
                now = time.monotonic()
                if now - self._logged < LOG_SECONDS:
                    continue
                self._logged = now
            self._write(in_words(event))

    def _read_text(self) -> None:
        assert self._process.stderr is not None
        for line in _lines(self._process.stderr):
            self._note(line)

    def _note(self, line: str) -> None:
        self._said.append(line.rstrip("\n"))
        self._write(line.rstrip("\n"))

    def _write(self, text: str) -> None:
        """A line of the log, with the time of day."""
        log = self._log_file
        if log is not None and text:
            try:
                log.write(f"{time.strftime('%H:%M:%S')}  {text}\n")
                log.flush()
            except (OSError, ValueError):  # the disk is full, or the job has been closed
                pass


def in_words(event: dict[str, Any]) -> str:
    """A line of the log; empty for what belongs on a screen only."""
    match event["event"]:
        case "message":
            return str(event.get("text", ""))
        case "stagestarted":
            return f"{event.get('stage')}: {event.get('total')} steps"
        case "progress":
            numbers = {name: event[name] for name in SHOWN if event.get(name)}
            shown = {n: round(v, 3) if isinstance(v, float) else v for n, v in numbers.items()}
            steps = f"{event.get('step')} of {event.get('total')}"
            return ", ".join(
                [f"{event.get('stage')}: {steps}", *(f"{n} {shown[n]}" for n in shown)]
            )
        case "done":
            return "Stopped." if event.get("stopped") else "Done."
        case "failed":
            return " ".join(str(event[part]) for part in ("message", "hint") if event.get(part))
    return ""


def parse_event(line: str) -> dict[str, Any] | None:
    """The event on a line, or None when it is none that the add-on knows.

    Beside `event` it holds those of its fields (see `FIELDS`) that are there with the right type:
    finite numbers, text that Blender can show, names and paths as text.
    """
    if len(line) > MAX_LINE:
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    name = record.get("event") if isinstance(record, dict) else None
    if not isinstance(name, str) or name not in FIELDS:
        return None
    event = {"event": name}
    for key, kind in FIELDS[name].items():
        value = _typed(record.get(key), kind)
        if value is not None:
            event[key] = value if key == "path" else _shown(value)
    return event


def _typed(value: Any, kind: type) -> Any:
    """The value when it is of that kind, else None."""
    if kind is dict and isinstance(value, dict):
        return {key: path for key, path in value.items() if isinstance(path, str)}
    if kind in (int, float):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        # The comparison is exact for integers of any size, and False for NaN.
        return kind(value) if number and abs(value) < MAX_NUMBER else None
    return value if isinstance(value, kind) else None


def _shown(value: Any) -> Any:
    """A text in one line that Blender's properties take: no control letters, no half ones."""
    if not isinstance(value, str):
        return value
    return "".join(c if c.isprintable() else " " for c in value)


def _lines(stream: IO[str]) -> Iterator[str]:
    """The stream's lines; of one that is too long, the beginning: the rest is not kept."""
    begins = True
    while part := stream.readline(MAX_LINE + 1):
        if begins:
            yield part
        begins = part.endswith("\n")
