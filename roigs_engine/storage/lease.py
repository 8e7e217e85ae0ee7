"""Leases on a store without locks: one engine at a time, even if another died or returns.

To get a lease, an engine writes its own file, as a claim, and then lists the folder. If there is no
holder, the claim with the smallest name becomes the holder. It lists again, and gives way if a
smaller name has appeared meanwhile. Every engine writes before it lists, so one of two always sees
the other. Engines rewrite their files regularly. A file that does not change for `EXPIRY` seconds,
by the watcher's own clock, is dead. So clocks of two machines are never compared.
"""

from __future__ import annotations

import json
import re
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress

from ..formats.text import parse_json
from .urls import FileSystem, small_files

EXPIRY, BEAT, POLL = 60.0, 10.0, 1.0  # seconds
CLAIM, HELD = "claim", "held"
NAME = re.compile("[0-9a-f]{32}")


class LeaseTakenError(Exception):
    """Another engine holds the lease and is alive, or a stop was requested while waiting."""


class Lease:
    """A lease, held during a `with` block.

    Args:
        found: the file system.
        folder: in it, for this lease alone.
        should_stop: asked while waiting.
        waits: called once if the lease cannot be taken at once.
        expiry, beat: seconds, for tests.
    """

    def __init__(
        self,
        found: FileSystem,
        folder: str,
        should_stop: Callable[[], bool] = lambda: False,
        *,
        waits: Callable[[], None] = lambda: None,
        expiry: float = EXPIRY,
        beat: float = BEAT,
    ) -> None:
        self._found, self._folder, self._should_stop = found, folder, should_stop
        self._expiry, self._beat, self._waits = expiry, beat, waits
        self._name, self._count = uuid.uuid4().hex, 0
        self._ended, self._lost = threading.Event(), False
        self._beats = threading.Thread(target=self._keep, daemon=True)
        self._seen: dict[str, tuple[bytes, float, int]] = {}  # content, since when, changes

    def is_held(self) -> bool:
        """Whether it is still held: others may take it over during a pause of this machine.

        If the store does not answer, the last answer counts: `EXPIRY` is long enough for that.
        """
        with suppress(Exception):  # stores raise various errors
            self._lost = self._lost or self._name not in self._names()
        return not self._lost

    def __enter__(self) -> Lease:
        """Take the lease; LeaseTakenError if another engine holds it."""
        try:
            said = False
            while not self._try():
                if self._should_stop():
                    raise LeaseTakenError
                if not said:
                    self._waits()
                    said = True
                time.sleep(min(POLL, self._beat))
        except BaseException:
            self._remove(self._name)
            raise
        self._beats.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._beats.join(self._expiry)  # otherwise a heartbeat may write the file again
        self._remove(self._name)

    def _try(self) -> bool:
        """Try to take the lease now; returns whether that succeeded. Raises as `__enter__`."""
        self._write(CLAIM)
        others = self._others()
        if any(state == HELD and self._seen[name][2] > 0 for name, state in others.items()):
            raise LeaseTakenError  # it has changed, so its process is alive
        if HELD in others.values() or any(name < self._name for name in others):
            return False
        self._write(HELD)
        while others := self._others():
            if any(name < self._name for name in others):
                return False
            if HELD not in others.values():
                break  # the others are claims with greater names; they see this one and give way
            self._write(HELD)  # a holder with a greater name is about to give way
            time.sleep(min(POLL, self._beat))
        return True

    def _others(self) -> dict[str, str]:
        """Name -> state of the other live files; dead ones are removed."""
        now, found = time.monotonic(), {}
        for name in self._names():
            if name == self._name:
                continue
            if self._should_stop():  # the loop may be long: there may be thousands of files
                raise LeaseTakenError
            try:
                content = bytes(self._found.cat_file(f"{self._folder}/{name}"))
                state = str(parse_json(content)["state"])
            except FileNotFoundError:
                continue
            except (ValueError, KeyError, TypeError):  # partly written
                content, state = b"", CLAIM
            before, since, changes = self._seen.get(name, (content, now, 0))
            if content != before:
                since, changes = now, changes + 1
            self._seen[name] = (content, since, changes)
            if now - since > self._expiry:
                self._remove(name)
            else:
                found[name] = state
        return found

    def _names(self) -> list[str]:
        with suppress(FileNotFoundError):
            listed = self._found.find(self._folder, detail=True)
            names = [str(path).rsplit("/", 1)[-1] for path in small_files(listed)]
            return list(filter(NAME.fullmatch, names))  # ignore files of other programs
        return []

    def _write(self, state: str) -> None:
        self._count += 1
        text = json.dumps({"state": state, "count": self._count})
        self._found.makedirs(self._folder, exist_ok=True)
        self._found.pipe_file(f"{self._folder}/{self._name}", text.encode())

    def _remove(self, name: str) -> None:
        with suppress(Exception):  # a file that stays expires; finished work is safe
            self._found.rm_file(f"{self._folder}/{name}")

    def _keep(self) -> None:
        """Rewrite the file at each beat, until the lease ends or is lost."""
        while not self._ended.wait(self._beat):
            with suppress(Exception):  # the store may be unreachable for a while
                if self._name not in self._names():
                    self._lost = True
                    return
                self._write(HELD)
