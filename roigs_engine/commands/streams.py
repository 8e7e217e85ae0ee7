"""Standard output and standard error that never raise, whatever reads them.

A reader may stop reading, a disk may be full, a terminal may vanish, a stream may be closed from
the start. None of this must end the work in a traceback. So everything that writes (the console,
progress bars, warnings, argparse) gets streams that record the error and continue.
"""

from __future__ import annotations

import errno
import io
import os
import select
import sys
from contextlib import suppress
from typing import Any

from .stopping import StopRequest

PIECE = getattr(select, "PIPE_BUF", 512)
"""Bytes that a pipe accepts without waiting if it has any room."""
PATIENCE = 5
"""After a stop request, total seconds to wait for a reader that does not read."""


class Stream(io.TextIOBase):
    """A text stream without a buffer. Writing never raises; `lost` is the first error.

    If the reader has gone, a stop is requested, as SIGPIPE would do. After other errors (a full
    disk), the next text is tried again.

    Args:
        raw: the stream for bytes.
        encoding: of the text; characters that it lacks are escaped.
        stop: the command's stop request.
    """

    encoding: str = "utf-8"

    def __init__(self, raw: io.RawIOBase, encoding: str, stop: StopRequest) -> None:
        self.encoding = encoding
        self.lost: OSError | None = None
        self.gone = False
        self.in_line = False  # whether the last line is unfinished, such as a progress bar
        self.replaced: Any = None  # kept, because its deletion would close `raw`
        self._raw, self._stop = raw, stop
        self._torn = False
        self._patience = PATIENCE

    def write(self, text: str) -> int:
        """Write text without a buffer; returns its length."""
        if text and not self.gone and not self._stop.leaving:
            self.in_line = not text.endswith("\n")
            lines = f"\n{text}" if self._torn else text
            data = lines.replace("\n", os.linesep).encode(self.encoding, "backslashreplace")
            try:
                self._send(data)
                self._torn = False
            except OSError as error:
                self._torn = True
                self.lost = self.lost or error
                if _reader_is_gone(error):
                    self.gone = self._stop.asked = True
        return len(text)

    def _send(self, data: bytes) -> None:
        while data:
            self._wait()
            # A Windows console decodes each piece separately, so none may end within a character.
            piece = data[:PIECE] if os.name == "posix" else data
            written = self._raw.write(piece)  # None: other writers have filled the pipe meanwhile
            data = data[written or 0 :]

    def _wait(self) -> None:
        """Wait for room. TimeoutError: a stop was requested, and `PATIENCE` is used up."""
        while os.name == "posix" and not select.select([], [self._raw], [], 1.0)[1]:
            if self._stop.asked:
                self._patience -= 1
            if self._patience < 0 or self._stop.leaving:
                raise TimeoutError(errno.ETIMEDOUT, "nobody reads")

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        """Whether a person may be reading."""
        with suppress(OSError):
            return self._raw.isatty()
        return False

    def fileno(self) -> int:
        """The file descriptor, for progress bars that ask for the width of the terminal."""
        return self._raw.fileno()


def protect(stop: StopRequest) -> Stream:
    """Replace `sys.stdout` and `sys.stderr` by streams that never fail; returns standard output.

    If one of these or standard input is closed, it becomes the null device. Otherwise the next file
    that is opened would get its descriptor, and be read or written instead.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor
    sys.stdout = _stream(sys.stdout, 1, stop)
    sys.stderr = _stream(sys.stderr, 2, stop)
    return sys.stdout


def _stream(stream: Any, number: int, stop: StopRequest) -> Stream:
    """A stream to replace Python's own, which is None if it was closed."""
    if stream is None:
        return Stream(io.FileIO(number, "w", closefd=False), "utf-8", stop)
    safe = Stream(getattr(stream.buffer, "raw", stream.buffer), stream.encoding, stop)
    safe.replaced = stream
    return safe


def _reader_is_gone(error: OSError) -> bool:
    """Whether the reader has gone, or has not read for too long."""
    # On Windows, the error of a pipe without a reader is EINVAL.
    return isinstance(error, (BrokenPipeError, TimeoutError)) or error.errno == errno.EINVAL
