"""The process that engine commands are forked from; see the package.

    python server.py SOCKET

It says `ready` once everything is imported, and ends when its standard input does. A command that
it forks goes on as `python -m MODULE` begins. What it is asked for is a list of the module and its
arguments, or of a module, a function's name and the function's arguments as bytes.
"""

from __future__ import annotations

import gc
import marshal
import os
import pickle
import runpy
import select
import shutil
import signal
import socket
import sys
import weakref
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from filelock import FileLock


class Server:
    """The commands that run, each with the connection of its client and a descriptor of it."""

    def __init__(self, address: str) -> None:
        self._folder = Path(address).parent
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(address)
        self._listener.listen(64)
        self._clients: dict[int, tuple[socket.socket, int]] = {}  # by the process's descriptor

    def serve(self) -> list[Any] | None:
        """Until the end of standard input: None. In a forked command: what it is asked for."""
        while True:
            clients = {client: process for process, (client, _) in self._clients.items()}
            ready, _, _ = select.select([0, self._listener, *clients, *self._clients], [], [])
            if 0 in ready and self._unused():
                return None
            for found in ready:
                if found in self._clients:
                    self._end(found)
                elif found in clients and clients[found] in self._clients:
                    self._signal(found, clients[found])
            if self._listener in ready:
                arguments = self._start()
                if arguments is not None:
                    return arguments

    def _unused(self) -> bool:
        """Whether nobody holds standard input open; nobody comes then any more."""
        with FileLock(self._folder / "lock"):
            if os.read(0, 1) or select.select([0], [], [], 0)[0] == []:
                return False
            shutil.rmtree(self._folder, ignore_errors=True)
        return True

    def _start(self) -> list[Any] | None:
        """Fork a command; what it is asked for in the new process, else None."""
        client, _ = self._listener.accept()
        head, streams, _, _ = socket.recv_fds(client, 8, 3)
        length, request = int.from_bytes(head, "little"), b""
        while len(request) < length:
            request += client.recv(length - len(request))
        asked, folder, variables = marshal.loads(request)
        if isinstance(asked[-1], bytes):
            import_module(asked[0])  # once for all
        pid = os.fork()
        if pid:
            for stream in streams:
                os.close(stream)
            self._clients[os.pidfd_open(pid)] = client, pid
            return None
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        for process, (other, _) in self._clients.items():
            os.close(process)
            other.close()
        client.close()
        self._listener.close()
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(variables)
        return list(asked)

    def _signal(self, client: socket.socket, process: int) -> None:
        """Hand on a signal, or end a command whose client is gone."""
        number = client.recv(1)
        signal.pidfd_send_signal(process, number[0] if number else signal.SIGKILL)

    def _end(self, process: int) -> None:
        client, pid = self._clients.pop(process)
        os.close(process)
        _, status = os.waitpid(pid, 0)
        code = os.waitstatus_to_exitcode(status)
        with suppress(OSError):  # the client was killed
            client.sendall(code.to_bytes(8, "little", signed=True))
        client.close()


def _spare_commands() -> None:
    """Leave commands no work on what is imported here: not in collections, and not at their end."""
    for finalizer in list(weakref.finalize._registry):
        finalizer.atexit = False
    gc.collect()
    gc.freeze()


def main() -> None:
    """Serve; in a forked command, be that."""
    del sys.path[0]  # this script's folder
    import_module("tests.preloaded")
    _spare_commands()
    server = Server(sys.argv[1])
    os.write(1, b"ready\n")
    asked = server.serve()
    if asked and isinstance(asked[-1], bytes):
        module, name, arguments = asked
        getattr(import_module(module), name)(*pickle.loads(arguments))
    elif asked is not None:
        if "ROIGS_TESTS_IMPORT" in os.environ:
            import_module(os.environ["ROIGS_TESTS_IMPORT"])
        sys.argv = list(asked)
        runpy.run_module(asked[0], run_name="__main__", alter_sys=True)


main()
