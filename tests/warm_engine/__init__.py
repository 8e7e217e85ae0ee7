"""Engine commands that start at once: forked from one process that has imported torch.

`python -m roigs_engine` takes two seconds until it begins. A test that is about what a command
does, and not about how its process starts, runs `client.py` instead: a small process that hands
its streams, folder and variables to a server and ends as the command does. Its signals reach the
command, and when it is killed, so is the command. Linux alone has what this needs; elsewhere, and
for other Pythons and other sources, commands start as always.
"""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def command(arguments: Sequence[object]) -> list[str]:
    """The command line of an engine command that starts at once, where that can be."""
    words = [str(argument) for argument in arguments]
    if sys.platform != "linux" or "python" not in Path(sys.executable).name:
        return [sys.executable, "-m", "roigs_engine", *words]
    return [sys.executable, "-I", "-S", str(HERE / "client.py"), _address(), *words]


def quick(usual: Callable[..., list[str]]) -> Callable[..., list[str]]:
    """The add-on's `Engine.command`, with commands of this checkout that start at once."""

    @functools.wraps(usual)
    def quick_command(engine: object, arguments: Sequence[str]) -> list[str]:
        words = usual(engine, arguments)
        mine = Path(words[0]) == Path(sys.executable) and Path(engine.source) == ROOT
        return command(arguments) if mine else words

    return quick_command


@functools.cache
def _address() -> str:
    """The socket of this process's server; it starts here, and ends with this process."""
    folder = tempfile.mkdtemp(prefix="roigs-warm-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    address = str(Path(folder) / "socket")
    server = subprocess.Popen(
        [sys.executable, str(HERE / "server.py"), address],
        cwd=ROOT,
        stdin=subprocess.PIPE,  # it ends when this is closed
        stdout=subprocess.PIPE,
        env=os.environ
        | {
            "PYTHONPATH": str(ROOT),
            "PYTHONUNBUFFERED": "1",
            "PYTHONUTF8": "1",
            "PYTHONNOUSERSITE": "1",
        },
    )
    assert server.stdout is not None
    assert server.stdout.readline() == b"ready\n", "the server of engines does not start"
    _servers.append(server)
    return address


_servers: list[subprocess.Popen[bytes]] = []
"""Kept, as their standard inputs must stay open."""
