"""Imports the package pycolmap when it is needed."""

from __future__ import annotations

import signal
import threading
from functools import cache
from typing import Any

from ..errors import EngineError


@cache
def pycolmap_module(purpose: str, otherwise: str = "") -> Any:
    """The module pycolmap with its log switched off; it raises what it would log as errors.

    Args:
        purpose: begins the error's sentence, such as "Undistorting photos".
        otherwise: what else the user can do, after "Install pycolmap".

    Raises:
        EngineError: pycolmap is not installed.
    """
    before = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise EngineError(
            f"{purpose} needs pycolmap, which is not installed ({error}).",
            f"Install pycolmap{otherwise}.",
        ) from error
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL.value)
    if threading.current_thread() is threading.main_thread():
        # The import installs a SIGTERM handler that prints a stack trace; restore the old handler.
        signal.signal(signal.SIGTERM, before)
    return pycolmap
