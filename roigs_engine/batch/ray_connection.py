"""A connection to a Ray cluster, whose calls end even if the cluster is gone."""

from __future__ import annotations

import atexit
import logging
import os
import queue
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from ..errors import ConfigError, EngineError

T = TypeVar("T")

CONNECT_SECONDS = 10.0
CALL_SECONDS = 30.0  # for the head to answer
JOIN_SECONDS, START_SECONDS = 50.0, 300.0  # to join a cluster, and to start one here
MOST_MISSED = 3  # looks for the head may fail until the cluster counts as gone
LOOPBACK, CLIENT = "127.0.0.1", "ray://"
SMALL_STORE = 80 << 20  # bytes: parts pass files, not objects


class Connection:
    """Ray, connected.

    Calls that ask the head wait for it a minute, and then Ray ends the whole process. So its port
    is looked at first, and the calls are made in threads that can be left behind.

    Args:
        address: `local`, `auto`, `HOST:PORT` or `ray://HOST:PORT`.

    Raises:
        ConfigError: Ray is not installed, or there is no cluster.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.ray = _connected(address)
        self._missed, self._gone = 0, False

    def is_there(self) -> bool:
        """Whether the head answers now.

        Raises:
            EngineError: it has not answered several times: the cluster is gone.
        """
        if self.address.startswith(CLIENT):  # whose calls fail by themselves
            return True
        place = host_and_port(self.ray.get_runtime_context().gcs_address)
        try:
            if place is not None:
                with socket.create_connection(place, CONNECT_SECONDS):
                    pass
        except OSError as error:
            self._missed += 1
            if self._missed >= MOST_MISSED:
                raise self._is_gone() from error
            return False
        self._missed = 0
        return True

    def ask(self, call: Callable[[], T]) -> T:
        """The answer to a call that may ask the head.

        Raises:
            EngineError: there is none: the cluster is gone.
        """
        try:
            return _within(CALL_SECONDS, call)
        except TimeoutError as silence:
            raise self._is_gone() from silence

    def close(self) -> None:
        """Leave the cluster; one that was started by this connection ends."""
        if self._gone:
            atexit.unregister(self.ray.shutdown)  # it would wait for the head
        else:
            with suppress(Exception):
                self.ray.shutdown()

    def _is_gone(self) -> EngineError:
        self._gone = True
        return EngineError(
            f"The Ray cluster {self.address} is gone.",
            "Start it again; the same command goes on.",
        )


def _within(seconds: float, call: Callable[[], T]) -> T:
    """The result of a call, made in a thread of its own; TimeoutError if there is none in time."""
    answers: queue.SimpleQueue[tuple[T | None, BaseException | None]] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put((call(), None))
        except BaseException as error:
            answers.put((None, error))

    threading.Thread(target=work, daemon=True).start()
    try:
        answer, error = answers.get(timeout=seconds)
    except queue.Empty:
        raise TimeoutError("it does not answer") from None
    if error is not None:
        raise error
    return answer  # type: ignore[return-value]


def _connected(address: str) -> Any:
    """The module ray, connected."""
    place = host_and_port(address.removeprefix(CLIENT))
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if place is not None and place[0] in (LOOPBACK, "localhost"):
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # else it goes outside
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
        _hush(ray)
        seconds = START_SECONDS if address == "local" else JOIN_SECONDS
        _within(seconds, lambda: ray.init(address=address, **options))
    except TimeoutError as error:
        atexit.unregister(ray.shutdown)
        raise _nothing_there(address, error) from error
    except (OSError, RuntimeError, ValueError, ConnectionError) as error:
        raise _nothing_there(address, error) from error
    return ray


def _nothing_there(address: str, error: Exception) -> ConfigError:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return ConfigError(
        f"There is no Ray cluster at {address} ({reason:.100}).",
        "Start one with `ray start --head`, or use --cluster local. If it wants a token, set"
        " RAY_AUTH_MODE=token (docs/many.md).",
    )


def _hush(ray: Any) -> None:
    """Keep what Ray prints of lost machines off standard output, which may be read as JSON."""
    with suppress(AttributeError):
        ray._private.worker.print_to_stdstream = lambda *_, **__: None


def host_and_port(address: str) -> tuple[str, int] | None:
    host, _, port = address.rpartition(":")
    return (host.strip("[]"), int(port)) if host and port.isdecimal() else None
