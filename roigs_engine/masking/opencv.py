"""OpenCV, an optional package, imported when it is used."""

from __future__ import annotations

from typing import Any

from ..errors import EngineError


def opencv() -> Any:
    """The module `cv2`; EngineError if it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise EngineError(
            f"Making masks needs OpenCV, which is not installed ({error}).",
            "Run: pip install opencv-python-headless (Blender: set up the engine again).",
        ) from error
    return cv2
