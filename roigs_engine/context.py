"""What long work is given besides its input: where events go, whether to stop, where to compute."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from .errors import Stopped
from .formats.events import Event, Message, Progress

Emit = Callable[[Event], None]


def _no_events(event: Event) -> None:
    """The sink for callers who want no events."""


def _never() -> bool:
    return False


@dataclass(frozen=True, kw_only=True)
class Context:
    """Passed down as one value, and never part of what decides a result.

    Attributes:
        emit: takes events.
        should_stop: whether somebody asked to stop; asked often, so it must be quick.
        device: where Gaussians are drawn and trained, as torch names it: `cpu`, `cuda:0`.
        photo_memory: bytes of decoded photos to keep; None: as `run.memory` plans.
    """

    emit: Emit = _no_events
    should_stop: Callable[[], bool] = _never
    device: str = "cpu"
    photo_memory: int | None = None

    def check_cancelled(self) -> None:
        """Raise `Stopped` if somebody asked to stop. Long work calls it every now and then."""
        if self.should_stop():
            raise Stopped

    def info(self, text: str) -> None:
        """Emit something a person may want to know."""
        self.emit(Message(text=text))

    def warn(self, text: str) -> None:
        """Emit something a person should know."""
        self.emit(Message(text=text, level="warning"))

    def progress(self, stage: str, step: int, total: int, started: float, **figures: float) -> None:
        """Emit progress of work that has no loss and began at `time.monotonic()` = `started`.

        Args: `figures`: `psnr`, dB, and `gaussians`, a count, where there are any.
        """
        self.emit(
            Progress(
                stage=stage,
                step=step,
                total=total,
                loss=math.nan,
                psnr=figures.get("psnr", math.nan),
                gaussians=int(figures.get("gaussians", 0)),
                seconds_left=(time.monotonic() - started) / step * (total - step),
            )
        )


QUIET = Context()
"""No events, no stop, on the CPU."""
