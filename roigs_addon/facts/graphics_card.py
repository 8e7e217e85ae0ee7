"""Finds the build of torch for this computer's graphics card, once, in a thread."""

from __future__ import annotations

import threading

import bpy

from ..engine import graphics_card
from ..engine.graphics_card import Choice
from ..windows import Timer, redraw

_found: list[Choice] = []
_thread: threading.Thread | None = None


def choice(*, wait: bool = False) -> Choice | None:
    """Return the build to install; None until the driver has answered.

    Args: `wait`: wait for the answer; scripts always wait.
    """
    global _thread
    if not _found and _thread is None:
        _thread = threading.Thread(target=_look, daemon=True)
        _thread.start()
        if not bpy.app.background:
            timer.start()
    if not _found and (wait or bpy.app.background) and _thread is not None:
        _thread.join()
    return _found[0] if _found else None


def _look() -> None:
    _found[:] = [graphics_card.choose(graphics_card.find())]


def forget() -> None:
    """Query again next time: a driver may have been installed."""
    global _thread
    if _thread is None or not _thread.is_alive():
        _found.clear()
        _thread = None


def _poll() -> bool:
    if _thread is not None and _thread.is_alive():
        return True
    redraw("PREFERENCES")
    return False


timer = Timer(_poll, 0.3, persistent=True)
