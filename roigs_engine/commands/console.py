"""A command's output (progress bar or JSON lines), and requests to stop it."""

from __future__ import annotations

import math
import os
import shutil
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, TextIO

from ..context import Context
from ..formats.events import (
    Board,
    Device,
    Done,
    Event,
    Failed,
    Message,
    Preview,
    Progress,
    StageStarted,
    device_in_words,
    to_json,
)
from ..formats.text import printable
from .stopping import StopRequest
from .streams import Stream

if TYPE_CHECKING:
    from tqdm import tqdm


class Console:
    """Shows events, and records whether a stop was requested.

    Args:
        json_lines: write one JSON line per event to standard output, and stop at the line 'stop' or
            the end of standard input; otherwise show a progress bar on standard error.
        stop: where stop requests are recorded.
    """

    def __init__(self, *, json_lines: bool, stop: StopRequest | None = None) -> None:
        self._json_lines = json_lines
        self._stop = stop or StopRequest()
        if json_lines and isinstance(sys.stdout, Stream):
            sys.stdout.encoding = "utf-8"  # other encodings' escapes would not be JSON
        self._bar: tqdm[None] | None = None
        self._drawn = 0  # lines of the board on the terminal
        self.resumes = False  # whether the same command resumes where it was stopped

    def watch(self) -> None:
        """Start to watch for stop requests: signals, and standard input (JSON lines)."""
        self._stop.watch_signals()
        if self._json_lines:
            threading.Thread(target=self._read_input, daemon=True).start()

    def should_stop(self) -> bool:
        return self._stop.asked

    @property
    def context(self) -> Context:
        """The context for a command's work: it sends events here, and takes stop requests."""
        person = not self._json_lines
        return Context(emit=self.emit, should_stop=self.should_stop, for_person=person)

    def emit(self, event: Event) -> None:
        """Show one event."""
        if isinstance(event, Board):
            self._show_board(event.lines)
        elif self._json_lines:
            _write(to_json(event), sys.stdout)
        else:
            self._show(event)

    def print(self, text: str) -> None:
        """Print the command's answer to standard output, or to standard error if that has JSON.

        Control characters are escaped, here and in `_line`, because names come from files.
        """
        self.close_bar()
        text = "\n".join(map(printable, text.split("\n")))
        _write(text, sys.stderr if self._json_lines else sys.stdout)

    def close_bar(self) -> None:
        """End the progress bar, if there is one."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _show(self, event: Event) -> None:
        match event:
            case Progress():
                self._advance(event)
            case StageStarted(stage=stage, total=total):
                self.close_bar()
                if total:
                    self._open_bar(stage, total)
            case Message(text=text, level=level):
                self._line(f"warning: {text}" if level == "warning" else text)
            case Device(reason="chosen"):
                pass  # the user chose the device
            case Device():
                self._line(f"Device: {device_in_words(asdict(event))}.")
            case Failed(message=message, hint=hint):
                self.close_bar()
                self._line(f"error: {message} {hint}".rstrip())
            case Done(stopped=True):
                how = "resumes from here" if self.resumes else "starts again"
                self._line(f"Stopped. The same command {how}.")
            case Done():
                self.close_bar()
            case Preview():
                pass

    def _open_bar(self, stage: str, total: int) -> None:
        """Open a progress bar if tqdm is installed (Blender's own Python does not have it)."""
        for name in [name for name in os.environ if name.startswith("TQDM_")]:
            del os.environ[name]  # tqdm raises an error for invalid ones
        try:
            from tqdm import tqdm
        except ImportError:
            self._line(f"{stage} …")
            return
        self._bar = tqdm(total=total, desc=printable(stage), file=sys.stderr, dynamic_ncols=True)

    def _advance(self, event: Progress) -> None:
        if self._bar is None:
            return
        parts = [
            "" if math.isnan(event.loss) else f"loss {event.loss:.4f}",
            "" if math.isnan(event.psnr) else f"{event.psnr:.2f} dB",
            f"{event.gaussians:,} Gaussians" if event.gaussians else "",
        ]
        self._bar.set_postfix_str(", ".join(filter(None, parts)), refresh=False)
        self._bar.update(event.step - self._bar.n)

    def _show_board(self, lines: Sequence[str]) -> None:
        """Draw the progress of a batch over the last one, if standard error is a terminal."""
        if self._json_lines or not sys.stderr.isatty():
            return
        self._clear_board()
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write("".join(f"{printable(line)[:width]}\n" for line in lines))
        self._drawn = len(lines)

    def _clear_board(self) -> None:
        if self._drawn:
            sys.stderr.write(f"\x1b[{self._drawn}A\x1b[J")
            self._drawn = 0

    def _line(self, text: str) -> None:
        text = printable(text)
        self._clear_board()
        if self._bar is not None:
            self._bar.write(text, file=sys.stderr)
        else:
            _write(text, sys.stderr)

    def _read_input(self) -> None:
        """Read lines until 'stop' or the end, without `sys.stdin`, whose lock would delay exit."""
        rest = b""
        while True:
            try:
                read = os.read(0, 4096)
            except OSError:
                break
            *lines, rest = (rest + read).split(b"\n")
            if not read or any(line.strip() == b"stop" for line in lines):
                break
        self._stop.asked = True


def _write(text: str, stream: TextIO) -> None:
    stream.write(f"{text}\n")
    stream.flush()
