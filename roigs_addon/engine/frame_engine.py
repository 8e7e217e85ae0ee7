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
END_SECONDS = 5.0
ENDED = "The engine ended while rendering."


class FrameEngine:
    """Draws one frame after the other; models stay in its memory. For one thread.

    Args:
        engine: to run.
        requests: an empty folder of its own.
        options: of the command.
    """

    def __init__(self, engine: Engine, requests: Path, options: list[str]) -> None:
        """Start it; raises OSError if the Python cannot be started."""
        self._requests = requests
        self._process = EngineProcess(engine, ["render-frames", str(requests), *options])

    def draw(self, request: dict[str, Any]) -> str:
        """Draw a frame and wait for it; returns what is wrong, or nothing."""
        self._process.events()  # of the frame before
        path = self._requests / f"frame{frame_requests.REQUEST}"
        files.write_json(path, request, durable=False)
        while path.exists():
            if not self._process.running():
                with suppress(OSError):
                    path.unlink()
                return self._process.result().message or ENDED
            time.sleep(PAUSE)
        warnings = []
        while True:  # the request is gone before its answer has come
            for event in self._process.events():
                if event["event"] == "preview":
                    return ""
                if event["event"] == "message" and event.get("level") == "warning":
                    warnings.append(str(event["text"]))
            if warnings:
                return " ".join(warnings)
            if not self._process.running():
                return self._process.result().message or ENDED
            time.sleep(PAUSE)

    def alive(self) -> bool:
        """Whether it can draw."""
        return self._process.running()

    def close(self) -> None:
        """End it."""
        self._process.stop()
        if not self._process.wait(END_SECONDS):
            self._process.kill()
        self._process.result()
