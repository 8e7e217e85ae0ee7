"""Code that runs on the machines of a Ray cluster: a check of the machine, and parts."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

from .. import __version__
from ..formats.events import Record
from .engine_process import FAILED, Outcome
from .parts import Part
from .staged import run_part

POST_SECONDS = 1.0
LONELY_SECONDS = 30.0  # without an answer: the batch has ended or is restarting the part
KEPT = ("progress",)  # events of which only the last in a second is posted


def look(sign: str) -> dict[str, Any]:
    """Check this machine: the version of its engine, and whether it sees a file of the batch."""
    return {"version": __version__, "sees": not sign or os.path.exists(sign)}


def do_part(part: Part, threads: int, mailbox: Any, version: str, sign: str) -> Outcome:
    """Run a part on this machine; its events go to a mailbox.

    Args:
        mailbox: a handle to a `Mailbox`.
        version: of the engine that runs the batch.
        sign: a file of the batch that every machine must see.
    """
    import ray

    node = ray.get_runtime_context().get_node_id()
    problem = misfit(look(sign), version, sign)
    if problem:
        return Outcome(state=FAILED, reason=f"A machine of the cluster {problem}.", node=node)
    post = _Post(part.key, mailbox)
    ended = run_part(part, threads, post.add, lambda: post.stop)
    post.close()
    return Outcome(state=ended.state, reason=ended.reason, node=node)


def misfit(found: dict[str, Any], version: str, sign: str) -> str:
    """The reason why a checked machine cannot be used; empty if it can."""
    if found["version"] != version:
        return f"has roigs {found['version']}, this computer {version}; install the same"
    if not found["sees"]:
        return f"does not see {os.path.dirname(sign)}; the folder must be shared under that path"
    return ""


class Mailbox:
    """Carries events from parts to the batch, and stop requests back."""

    def __init__(self) -> None:
        self._events: list[tuple[tuple[str, str], Record]] = []
        self._stop = False
        self._stopped: set[tuple[str, str]] = set()

    def put(self, key: tuple[str, str], events: list[Record]) -> bool:
        """Add events; returns whether the part should stop."""
        self._events += [(key, event) for event in events]
        return self._stop or key in self._stopped

    def take(
        self, stop: bool, stopped: set[tuple[str, str]]
    ) -> list[tuple[tuple[str, str], Record]]:
        """Take new events; sets whether all parts (`stop`) or some of them must stop."""
        self._stop, self._stopped = stop, stopped
        events, self._events = self._events, []
        return events


class _Post:
    """Posts events once a second, in a thread.

    If the mailbox does not answer for long, the part stops with a checkpoint: its batch has ended,
    and the next one waits for the run folder.
    """

    def __init__(self, key: tuple[str, str], mailbox: Any) -> None:
        self.stop = False
        self._key, self._mailbox = key, mailbox
        self._events: list[Record] = []
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def add(self, event: Record) -> None:
        """Keep an event for the next post."""
        with self._lock:
            if self._events and event["event"] in KEPT == (self._events[-1]["event"],):
                self._events.pop()
            self._events.append(event)

    def close(self) -> None:
        """Post the remaining events."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        import ray

        ended, answered = False, time.monotonic()
        while not ended:
            ended = self._ended.wait(POST_SECONDS)
            with self._lock:
                events, self._events = self._events, []
            try:
                put = self._mailbox.put.remote(self._key, events)
                self.stop = self.stop or bool(ray.get(put, timeout=10 * POST_SECONDS))
                answered = time.monotonic()
            except ray.exceptions.RayError:
                self.stop = self.stop or time.monotonic() - answered > LONELY_SECONDS
