"""A thread for work that would make the window stutter. No bpy."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """The return value of a task, or the exception that it raised."""

    value: Any = None
    error: Exception | None = None


class Worker:
    """Does tasks one after another; of tasks with the same name only the newest counts.

    The thread starts with the first task. All methods may be called from any thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._changed = threading.Condition()
        self._waiting: dict[Hashable, Callable[[], Any]] = {}
        self._running: Hashable | None = None
        self._done: dict[Hashable, Outcome] = {}
        self._thread: threading.Thread | None = None
        self._closed = False

    def submit(self, name: Hashable, task: Callable[[], Any]) -> None:
        """Do `task` soon; one of the same name that has not started is dropped."""
        with self._changed:
            if self._closed:
                return
            self._waiting[name] = task
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def take(self, name: Hashable) -> Outcome | None:
        """The newest outcome of that name, unless it was taken already."""
        with self._changed:
            return self._done.pop(name, None)

    def busy(self, name: Hashable) -> bool:
        """Whether a task of that name is waiting or running."""
        with self._changed:
            return name in self._waiting or name == self._running

    def pending(self, name: Hashable) -> bool:
        """Whether a task of that name is waiting, running, or done and not taken yet."""
        with self._changed:
            return name in self._waiting or name == self._running or name in self._done

    def idle(self) -> bool:
        """Whether nothing is waiting or running."""
        with self._changed:
            return not self._waiting and self._running is None

    def forget(self, name: Hashable) -> None:
        """Drop the waiting task of that name, and its outcome."""
        with self._changed:
            self._waiting.pop(name, None)
            self._done.pop(name, None)

    def close(self) -> None:
        """Drop waiting tasks and end the thread, after the task that is running."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._done.clear()
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                name = next(iter(self._waiting))
                task = self._waiting.pop(name)
                self._running = name
            try:
                outcome = Outcome(value=task())
            except Exception as error:
                outcome = Outcome(error=error)
            # Nothing of a large task may stay in memory until the next one comes.
            del task
            with self._changed:
                self._running = None
                if not self._closed:
                    self._done[name] = outcome
                self._changed.notify_all()
            del outcome
