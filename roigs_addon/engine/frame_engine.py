"""The engine process that draws frames while Blender renders. No bpy."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..shared import files, frame_requests
from .command import Engine
from .process import EngineProcess

PAUSE = 0.005
LONGEST_PAUSE = 1.0  # seconds; during a longer one, the computer was asleep
END_SECONDS = 5.0
ENDED = "The engine ended while rendering."
SILENT_SECONDS = 600.0
"""A frame is given up after this time without an event. A working engine is silent at most while it
reads one model, or draws one frame."""
HUNG = (
    "The render lacks the Gaussians: the engine did not respond for {:.0f} minutes and was ended."
)


class FrameEngine:
    """Draws one frame after the other; models stay in its memory. For one thread.

    Args:
        engine: the engine to run.
        requests: an empty folder for it alone.
        options: of the command.
    """

    def __init__(self, engine: Engine, requests: Path, options: list[str]) -> None:
        """Start it; raises OSError if the Python cannot be started."""
        self._requests, self._hung = requests, False
        self._process = EngineProcess(engine, ["render-frames", str(requests), *options])

    def draw(self, request: dict[str, Any]) -> str:
        """Draw a frame and wait for it; return an error, or an empty string.

        Only a render engine, not a handler, learns from Blender that the user has cancelled the
        render. So the wait ends with the frame, or when the engine hangs.
        """
        self._process.events()  # drop those of the frame before
        path = self._requests / f"frame{frame_requests.REQUEST}"
        files.write_json(path, request, durable=False)
        drawn, warnings, silence = False, [], _Silence()
        while True:
            # The engine deletes the request last, but its events may arrive later.
            gone = not path.exists()
            for event in self._process.events():
                silence.end()
                drawn = drawn or event["event"] == "preview"
                if event["event"] == "message" and event.get("level") == "warning":
                    warnings.append(str(event["text"]))
            if gone and (drawn or warnings):
                return "" if drawn else " ".join(warnings)
            if not self._process.running():
                _forget(path)
                return self._process.result().message or ENDED
            if silence.seconds() > SILENT_SECONDS:
                self._hung = True
                self._process.kill()
                _forget(path)
                return HUNG.format(SILENT_SECONDS / 60)
            time.sleep(PAUSE)

    def alive(self) -> bool:
        """Whether it can draw."""
        return not self._hung and self._process.running()

    def close(self) -> None:
        """End the engine. If even the system cannot end the process, it is left behind."""
        self._process.stop()
        if not self._process.wait(END_SECONDS):
            self._process.kill()
            if not self._process.wait(END_SECONDS):
                return
        self._process.result()


class _Silence:
    """Measures the time without an event, except while the computer was asleep."""

    def __init__(self) -> None:
        self._seconds, self._last = 0.0, time.monotonic()

    def end(self) -> None:
        """Reset the time: an event arrived."""
        self._seconds = 0.0

    def seconds(self) -> float:
        """Return the seconds since the last event; call this often."""
        now = time.monotonic()
        self._seconds += min(now - self._last, LONGEST_PAUSE)
        self._last = now
        return self._seconds


def _forget(path: Path) -> None:
    """Delete a request that no engine will answer."""
    with suppress(OSError):
        path.unlink()
