"""Context of long work: receiver of events, stop requests, computing device."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from .errors import Stopped, shortened
from .formats.events import Event, Message, Progress

Emit = Callable[[Event], None]
Value = TypeVar("Value")
POLL_SECONDS = 0.1


@dataclass(frozen=True, kw_only=True)
class Context:
    """Passed down as one value; nothing in it changes a result, except for rounding on a GPU.

    Functions that take one report messages and progress to it, and raise `Stopped` on request.

    Attributes:
        emit: receives events.
        should_stop: whether a stop was requested; called often, so it must be fast.
        device: where Gaussians are rendered and trained, in torch's notation: `cpu`, `cuda:0`.
        photo_memory: bytes of decoded photos to keep; None: `run.memory` decides.
        for_person: whether a person reads the events, who wants results of a batch's parts alone.
    """

    emit: Emit = lambda event: None
    should_stop: Callable[[], bool] = lambda: False
    device: str = "cpu"
    photo_memory: int | None = None
    for_person: bool = False

    def check_cancelled(self) -> None:
        """Raise `Stopped` if a stop was requested. Long work calls this regularly."""
        if self.should_stop():
            raise Stopped

    def interruptible(self, work: Callable[[], Value]) -> Value:
        """Run `work`, which cannot check for stop requests itself (a library); return its result.

        Raises what it raises, and `Stopped` on request: the work is left to itself then, in a
        thread, so it must not write.
        """
        result: list[Value] = []
        failed: list[BaseException] = []

        def run() -> None:
            try:
                result.append(work())
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        while thread.is_alive():
            thread.join(POLL_SECONDS)
            self.check_cancelled()
        self.check_cancelled()
        if failed:
            raise failed.pop()  # its traceback holds this frame: no circle keeps what was read
        return result[0]

    def info(self, text: str, level: str = "info") -> None:
        """Emit a message for the user, which is shortened as an error's hint is."""
        self.emit(Message(text=shortened(text), level=level))

    def warn(self, text: str) -> None:
        """Emit a warning for the user; as `info`."""
        self.info(text, "warning")

    def progress(self, stage: str, step: int, total: int, started: float, **metrics: float) -> None:
        """Emit progress of work that has no loss.

        Args:
            stage: name of the work.
            step, total: units of work done, and all of them.
            started: `time.monotonic()` when the work began.
            metrics: optional `psnr` (dB) and `gaussians` (count).
        """
        self.emit(
            Progress(
                stage=stage,
                step=step,
                total=total,
                loss=math.nan,
                psnr=metrics.get("psnr", math.nan),
                gaussians=int(metrics.get("gaussians", 0)),
                seconds_left=(time.monotonic() - started) / step * (total - step),
            )
        )


QUIET = Context()
"""No events, no stop, on the CPU."""
