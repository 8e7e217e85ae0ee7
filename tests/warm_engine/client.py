"""In place of `python -m roigs_engine`: gives this process's streams to the server, and waits.

    python -I -S client.py SOCKET ARGUMENT...

Little is imported, so it starts in some hundredths of a second.
"""

import marshal
import os
import signal
import socket
import sys

FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Send the request; end with the command's exit status, or by its signal."""
    server = socket.socket(socket.AF_UNIX)
    server.connect(sys.argv[1])
    for number in FORWARDED:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda number, _: server.send(bytes([number])))
    request = marshal.dumps((sys.argv[2:], os.getcwd(), dict(os.environ)))
    socket.send_fds(server, [len(request).to_bytes(8, "little")], [0, 1, 2])
    server.sendall(request)
    for stream in (0, 1, 2):  # the command alone has them now
        os.close(stream)
    answer = server.recv(8)
    status = int.from_bytes(answer, "little", signed=True) if answer else 1
    if status < 0:
        if -status != signal.SIGKILL:
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status)


main()
