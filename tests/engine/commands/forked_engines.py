"""Engines of a batch that start at once: forked from a process that has imported all they need.

A new Python with torch takes seconds. Everything else is as it is: pipes, events, exit status.
`test_engine_process.py` and `test_ray.py` start engines as users do.
"""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing.connection import Connection
from types import SimpleNamespace
from typing import Any

import pytest

from roigs_engine import cli
from roigs_engine.batch import engine_process

CAN_FORK = os.name == "posix"
CONTEXT: Any = multiprocessing.get_context("forkserver" if CAN_FORK else "spawn")
CONTEXT.set_forkserver_preload([__name__, "tests.preloaded"])


class ForkedEngine:
    """What `engine_process` uses of a `subprocess.Popen`."""

    def __init__(self, command: list[str], *, stderr: Any, **_: Any) -> None:
        read_in, write_in = os.pipe()
        read_out, write_out = os.pipe()
        streams = [Connection(read_in, writable=False), Connection(write_out, readable=False)]
        errors = Connection(os.dup(stderr.fileno()), readable=False)
        argv = command[command.index("roigs_engine") + 1 :]
        self._process = CONTEXT.Process(target=_engine, args=(argv, *streams, errors), daemon=True)
        self._process.start()
        for stream in (*streams, errors):
            stream.close()
        self.stdin = os.fdopen(write_in, "wb")
        self.stdout = os.fdopen(read_out, "rb")

    def wait(self) -> int:
        self._process.join()
        self.stdout.close()
        return int(self._process.exitcode)


def _engine(argv: list[str], given: Connection, out: Connection, errors: Connection) -> None:
    for number, stream in enumerate((given, out, errors)):
        os.dup2(stream.fileno(), number)
    os._exit(cli.main(argv))


@pytest.fixture(scope="module")
def forked_engines() -> Any:
    """The batches of a module's tests that are called in this process fork their engines."""
    with pytest.MonkeyPatch.context() as patch:
        if CAN_FORK:
            forked = SimpleNamespace(Popen=ForkedEngine, PIPE=None)
            patch.setattr(engine_process, "subprocess", forked)
        yield
