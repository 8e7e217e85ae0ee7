"""Log of a run folder: events.jsonl has every event as a JSON line, and the end of the work."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from ..context import Context
from ..errors import EngineError, RunFolderError, Stopped
from ..formats.events import Done, Event, Failed, Message, to_json
from ..formats.files import cannot_write, open_log
from ..formats.lock import check_held
from ..formats.run_files import EVENTS
from ..machine import NO_MEMORY, is_memory_full, more_memory


class EventLog:
    """Passes events on to a context, and logs them once the folder is known.

    The last event has `outputs`: name -> path of each file made.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._file: TextIO | None = None
        self._path: Path | None = None
        self._early: list[str] = []  # until the file is open
        self.outputs: dict[str, str] = {}

    @property
    def is_open(self) -> bool:
        """Whether the folder is known."""
        return self._path is not None

    def open(self, folder: Path) -> None:
        """Log to `folder`/events.jsonl, earlier events too; RunFolderError on failure."""
        if self._path is not None:
            return
        path = folder / EVENTS
        try:
            self._file = open_log(path)
        except OSError as error:
            raise cannot_write(path, error) from error
        self._path = path
        if self._early:
            self._append("\n".join(self._early))

    def emit(self, event: Event) -> None:
        """Pass an event on, and log it."""
        self.note(event)
        self._context.emit(event)

    def note(self, event: Event) -> None:
        """Log an event."""
        if self._path is None:
            self._early.append(to_json(event))
        elif self._file is not None:
            with suppress(RunFolderError):  # another process has taken over the folder
                check_held(self._path)
                self._append(to_json(event))

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def _append(self, line: str) -> None:
        """Append a line. A full disk ends the log, but not the work."""
        assert self._file is not None
        try:
            self._file.write(f"{line}\n")
            self._file.flush()
        except OSError as error:
            with suppress(OSError):  # closing tries to write the rest again
                self._file.close()
            self._file = None
            text = f"Events are no longer written to events.jsonl ({error.strerror or error})."
            self._context.emit(Message(text=text, level="warning"))


@contextmanager
def logged(context: Context) -> Iterator[tuple[Context, EventLog]]:
    """Give a context whose events are logged, and its log; at the end, log how the block ended."""
    log = EventLog(context)
    try:
        yield replace(context, emit=log.emit), log
        log.note(Done(outputs=log.outputs))
    except Stopped as stopped:
        stopped.resumes = stopped.resumes or log.is_open
        log.note(Done(outputs={}, stopped=True))
        raise
    except Exception as error:
        if (failed := failure(error)) is not None:
            log.note(failed)
        raise
    finally:
        log.close()


def failure(error: Exception) -> Failed | None:
    """Return the event of an error of the engine, a file, or full memory; None for a bug."""
    if isinstance(error, EngineError):
        return Failed(message=error.message, hint=error.hint)
    if is_memory_full(error):
        return Failed(message=NO_MEMORY, hint=more_memory())
    if isinstance(error, OSError) and error.filename is not None:
        name = f"{os.fsdecode(error.filename):.200}"
        return Failed(message=f"Cannot use {name!r} ({error.strerror}).", hint="Choose another.")
    return None
