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
"""Bytes that a pipe with any room takes without waiting."""
PATIENCE = 5
"""Seconds in all that a stop waits for a reader that does not read."""


class Stream(io.TextIOBase):
    """A text stream without a buffer. Writing never raises; `lost` is the first error.

    A reader that has gone away asks for a stop, as SIGPIPE would. After other errors (a full disk),
    writing is tried again with the next text.

    Args:
        raw: where bytes are written.
        encoding: of the text; characters that it lacks are written as escapes.
        stop: of the command.
    """

    encoding: str = "utf-8"

    def __init__(self, raw: io.RawIOBase, encoding: str, stop: StopRequest) -> None:
        self.encoding = encoding
        self.lost: OSError | None = None
        self.gone = False
        self.in_line = False  # whether the last text was the start of a line, as of a progress bar
        self.replaced: Any = None  # kept, for it would close `raw` when it is deleted
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
            # A Windows console decodes each piece by itself: one must not end within a character.
            piece = data[:PIECE] if os.name == "posix" else data
            written = self._raw.write(piece)  # None: others have filled the pipe meanwhile
            data = data[written or 0 :]

    def _wait(self) -> None:
        """Wait until there is room; TimeoutError: stopped, and not read for `PATIENCE` seconds."""
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
    """Make `sys.stdout` and `sys.stderr` streams that never fail; returns standard output.

    Closed ones, and a closed standard input, become the null device. Otherwise the next files that
    are opened would get their numbers, and be read and written in their place.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
    sys.stdout = _stream(sys.stdout, 1, stop)
    sys.stderr = _stream(sys.stderr, 2, stop)
    return sys.stdout


def _stream(stream: Any, number: int, stop: StopRequest) -> Stream:
    """A stream in the place of Python's own, which is None if it was closed."""
    if stream is None:
        return Stream(io.FileIO(number, "w", closefd=False), "utf-8", stop)
    safe = Stream(getattr(stream.buffer, "raw", stream.buffer), stream.encoding, stop)
    safe.replaced = stream
    return safe


def _reader_is_gone(error: OSError) -> bool:
    """Whether the reader is gone, or did not read for long enough."""
    # Windows says EINVAL of a pipe without a reader.
    return isinstance(error, (BrokenPipeError, TimeoutError)) or error.errno == errno.EINVAL
