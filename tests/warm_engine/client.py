"""In place of `python -m MODULE`: gives this process's streams to the server, and waits.

    python -I -S client.py SOCKET MODULE ARGUMENT...

Only built-in modules are imported: `signal` and `socket` would take most of its time.
"""

import _signal
import _socket
import marshal
import os
import sys

FORWARDED = (_signal.SIGINT, _signal.SIGTERM, _signal.SIGHUP)


def main() -> None:
    """Send the request; end with the command's exit status, or by its signal."""
    server = _socket.socket(_socket.AF_UNIX)
    server.connect(sys.argv[1])
    for number in FORWARDED:
        if _signal.getsignal(number) is not _signal.SIG_IGN:
            _signal.signal(number, lambda number, _: server.send(bytes([number])))
    request = marshal.dumps((sys.argv[2:], os.getcwd(), dict(os.environ)))
    streams = b"".join(stream.to_bytes(4, sys.byteorder) for stream in (0, 1, 2))
    ancillary = [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, streams)]
    server.sendmsg([len(request).to_bytes(8, "little")], ancillary)
    server.sendall(request)
    for stream in (0, 1, 2):  # the command alone has them now
        os.close(stream)
    answer = server.recv(8)
    status = int.from_bytes(answer, "little", signed=True) if answer else 1
    if status < 0:
        if -status != _signal.SIGKILL:
            _signal.signal(-status, _signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status)


main()
