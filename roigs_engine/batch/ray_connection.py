"""A connection to a Ray cluster. Its calls also return if the cluster is gone."""

from __future__ import annotations

import atexit
import logging
import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from ..errors import ConfigError, EngineError
from ..formats.text import first_line

T = TypeVar("T")

CONNECT_SECONDS = 10.0
LOOK_EVERY, POLL = 5.0, 0.5  # seconds
JOIN_SECONDS, START_SECONDS = 50.0, 300.0  # to join a cluster; to start one here
MOST_MISSED = 3  # failed checks of the head after which the cluster counts as lost
NO_RAY = "any running Ray instance"  # in Ray's message if `auto` finds no cluster
LOOPBACK, CLIENT = "127.0.0.1", "ray://"
SMALL_STORE = 80 << 20  # bytes; enough, because parts pass files, not objects


class Connection:
    """A connection to Ray.

    A call that needs the head waits for it for a minute, and then Ray ends the whole process. So a
    thread checks the head, and calls are made in threads that can be abandoned.

    Args:
        address: `local`, `auto`, `HOST:PORT` or `ray://HOST:PORT`.

    Raises:
        ConfigError: Ray is not installed, or there is no cluster.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.ray = _connected(address)
        self._gone, self._closed = threading.Event(), threading.Event()
        if not address.startswith(CLIENT):  # a client's calls fail by themselves
            place = host_and_port(self.ray.get_runtime_context().gcs_address)
            if place is not None:
                threading.Thread(target=self._watch, args=(place,), daemon=True).start()

    def ask(self, call: Callable[[], T]) -> T:
        """Make calls of Ray and return their result; EngineError: the cluster is gone."""
        try:
            return _in_thread(call, self._gone.is_set)
        except (TimeoutError, ConnectionError) as error:
            self._gone.set()
            raise EngineError(
                f"The Ray cluster {self.address} is gone.",
                "Start it again; the same command resumes.",
            ) from error

    def close(self) -> None:
        """Leave the cluster; if this connection started it, it ends."""
        self._closed.set()
        if self._gone.is_set():
            atexit.unregister(self.ray.shutdown)  # it would wait for the head
        else:
            with suppress(Exception):
                _in_thread(self.ray.shutdown, self._gone.is_set)

    def _watch(self, place: tuple[str, int]) -> None:
        """Check the head until it has failed to answer several times."""
        missed = 0
        while not self._closed.wait(LOOK_EVERY):
            try:
                with socket.create_connection(place, CONNECT_SECONDS):
                    missed = 0
            except OSError:
                missed += 1
            if missed >= MOST_MISSED:
                self._gone.set()
                return


def _in_thread(call: Callable[[], T], give_up: Callable[[], bool], *, stay: bool = False) -> T:
    """Make a call in its own thread and return its result; TimeoutError if it is given up.

    With `stay`, the thread does not end: on Linux, programs that Ray started in it would end, too.
    """
    answers: queue.SimpleQueue[tuple[T | None, BaseException | None]] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put((call(), None))
        except BaseException as error:
            answers.put((None, error))
        if stay:
            threading.Event().wait()

    threading.Thread(target=work, daemon=True).start()
    while True:
        with suppress(queue.Empty):
            answer, error = answers.get(timeout=POLL)
            if error is not None:
                raise error
            return answer  # type: ignore[return-value]
        if give_up():
            raise TimeoutError("it does not answer")


def _connected(address: str) -> Any:
    place = host_and_port(address.removeprefix(CLIENT))
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address == "local" or (place is not None and place[0] in (LOOPBACK, "localhost")):
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # stay on this machine
    try:
        import ray
    except ImportError as error:
        raise ConfigError(
            f"--cluster needs Ray, which is not installed in {sys.executable}.",
            f"Install it ({sys.executable} -m pip install 'ray[client]'), or leave out --cluster.",
        ) from error
    options: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address == "local":
        options |= {"_node_ip_address": LOOPBACK, "include_dashboard": False}
        options |= {"object_store_memory": SMALL_STORE}
    if address not in ("local", "auto") and place is None:
        raise ConfigError(
            f"--cluster {address:.60} is no address.", "Use local, auto or ray://HOST:10001."
        )
    try:
        if place is not None:
            with socket.create_connection(place, CONNECT_SECONDS):
                pass
        with suppress(AttributeError):  # Ray's messages on lost machines are not JSON
            ray._private.worker.print_to_stdstream = lambda *_, **__: None
        seconds = START_SECONDS if address == "local" else JOIN_SECONDS
        until = time.monotonic() + seconds
        _in_thread(
            lambda: ray.init(address=address, **options),
            lambda: time.monotonic() > until,
            stay=address == "local",
        )
    except TimeoutError as error:
        atexit.unregister(ray.shutdown)
        raise _nothing_there(address, error) from error
    except (OSError, RuntimeError, ValueError, ConnectionError) as error:
        raise _nothing_there(address, error) from error
    return ray


def _nothing_there(address: str, error: Exception) -> ConfigError:
    if address == "auto" and NO_RAY in str(error):
        return ConfigError(
            "--cluster auto: this machine belongs to no Ray cluster.",
            "Start one here with `ray start --head`, join one with `ray start --address=HOST:6379`,"
            " or use --cluster local, a Ray of this machine alone.",
        )
    return ConfigError(
        f"There is no Ray cluster at {address} ({first_line(error):.100}).",
        "Start one there with `ray start --head`, correct the address, or use --cluster local. If"
        " it wants a token, set RAY_AUTH_MODE=token (docs/many.md).",
    )


def host_and_port(address: str) -> tuple[str, int] | None:
    """Host and port of `HOST:PORT`; None for other texts."""
    host, _, port = address.rpartition(":")
    return (host.strip("[]"), int(port)) if host and port.isdecimal() else None
