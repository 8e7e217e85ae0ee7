"""The process that engine commands are forked from; see the package.

    python server.py SOCKET

It says `ready` once everything is imported, and ends when its standard input does. A command that
it forks goes on as `python -m roigs_engine` begins.
"""

from __future__ import annotations

import gc
import marshal
import os
import runpy
import select
import signal
import socket
import sys
import weakref
from contextlib import suppress
from importlib import import_module


class Server:
    """The commands that run, each with the connection of its client and a descriptor of it."""

    def __init__(self, address: str) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(address)
        self._listener.listen(64)
        self._clients: dict[int, tuple[socket.socket, int]] = {}  # by the process's descriptor

    def serve(self) -> list[str] | None:
        """Until the end of standard input: None. In a forked command: its arguments."""
        while True:
            clients = {client: process for process, (client, _) in self._clients.items()}
            ready, _, _ = select.select([0, self._listener, *clients, *self._clients], [], [])
            if 0 in ready and not os.read(0, 1):
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

    def _start(self) -> list[str] | None:
        """Fork a command; its arguments in the new process, else None."""
        client, _ = self._listener.accept()
        head, streams, _, _ = socket.recv_fds(client, 8, 3)
        length, request = int.from_bytes(head, "little"), b""
        while len(request) < length:
            request += client.recv(length - len(request))
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
        arguments, folder, variables = marshal.loads(request)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(variables)
        return list(arguments)

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
    arguments = server.serve()
    if arguments is not None:
        sys.argv = ["roigs_engine", *arguments]
        runpy.run_module("roigs_engine", run_name="__main__", alter_sys=True)


main()
