"""Engine commands that start at once: forked from one process that has imported torch.

`python -m roigs_engine` takes two seconds until it begins. A test that is about what a command
does, and not about how its process starts, runs `client.py` instead: a small process that hands
its streams, folder and variables to a server and ends as the command does. Its signals reach the
command, and when it is killed, so is the command. Linux alone has what this needs; elsewhere, and
for other Pythons and other sources, commands start as always.

`Process` has a function called in such a fork, with no process between. All test processes of a run
share one server.
"""

from __future__ import annotations

import functools
import marshal
import multiprocessing
import os
import pickle
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SERVER = "ROIGS_TESTS_SERVER"
"""The variable with the server's socket."""
IMPORTED_FIRST = "ROIGS_TESTS_IMPORT"
"""The variable with a module that a forked command imports before it begins."""
CAN_FORK = sys.platform == "linux" and "python" in Path(sys.executable).name


def command(arguments: Sequence[object]) -> list[str]:
    """The command line of an engine command that starts at once, where that can be."""
    return module("roigs_engine", arguments)


def module(name: str, arguments: Sequence[object] = ()) -> list[str]:
    """The command line of a module that is run as `python -m` runs it."""
    words = [name, *map(str, arguments)]
    if not CAN_FORK:
        return [sys.executable, "-m", *words]
    return [sys.executable, "-I", "-S", str(HERE / "client.py"), _address(), *words]


def quick(usual: Callable[..., list[str]]) -> Callable[..., list[str]]:
    """The add-on's `Engine.command`, with commands of this checkout that start at once."""

    @functools.wraps(usual)
    def quick_command(engine: object, arguments: Sequence[str]) -> list[str]:
        words = usual(engine, arguments)
        mine = Path(words[0]) == Path(sys.executable) and Path(engine.source) == ROOT
        return command(arguments) if mine else words

    return quick_command


class ForkedProcess:
    """A function of a module that a fork of the server calls; as `multiprocessing.Process`."""

    def __init__(
        self,
        target: Callable[..., object],
        args: Sequence[object] = (),
        streams: Sequence[int] = (0, 1, 2),
    ) -> None:
        self._call = [target.__module__, target.__qualname__, pickle.dumps(tuple(args))]
        self._streams, self._server = list(streams), socket.socket(socket.AF_UNIX)
        self.exitcode: int | None = None

    def start(self) -> None:
        """Start it with descriptors for its three streams, which this process may close then."""
        self._server.connect(_address())
        request = marshal.dumps((self._call, os.getcwd(), dict(os.environ)))
        socket.send_fds(self._server, [len(request).to_bytes(8, "little")], self._streams)
        self._server.sendall(request)

    def join(self) -> None:
        """Wait for its end."""
        answer = self._server.recv(8)
        self._server.close()
        assert answer, "the server of engines is gone"
        self.exitcode = int.from_bytes(answer, "little", signed=True)


Process: Any = ForkedProcess if CAN_FORK else multiprocessing.get_context("spawn").Process


@functools.cache
def _address() -> str:
    """The socket of this test run's server: it starts with the first process that asks.

    It ends when nobody holds its standard input open, a named pipe.
    """
    if SERVER in os.environ:  # a process that a test has started
        return os.environ[SERVER]
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", "")
    folder = Path(tempfile.gettempdir(), f"roigs-warm-{run or os.getpid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    address, pipe = folder / "socket", folder / "pipe"
    with FileLock(folder / "lock"):
        if not pipe.exists():
            os.mkfifo(pipe, 0o600)
        _held.append(os.open(pipe, os.O_RDWR))
        if not address.exists():
            _start(address, pipe)
    os.environ[SERVER] = str(address)
    return str(address)


def _start(address: Path, pipe: Path) -> None:
    variables = {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONNOUSERSITE": "1"}
    with pipe.open("rb") as held:
        server = subprocess.Popen(
            [sys.executable, str(HERE / "server.py"), str(address)],
            cwd=ROOT,
            stdin=held,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": str(ROOT)} | variables,
        )
    assert server.stdout is not None
    assert server.stdout.readline() == b"ready\n", "the server of engines does not start"
    _held.append(server)


_held: list[object] = []
"""The open end of the pipe, as long as this process lives."""
