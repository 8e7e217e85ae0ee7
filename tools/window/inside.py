"""Runs in Blender: does what the driver asks, on the main thread, and answers.

Lines come on standard input as `NUMBER CODE` (JSON: [number, code]); the answer is a line
`@answer [number, ok, value]` on standard output. CODE is an expression or statements; what it
prints or returns is for the driver alone.
"""

from __future__ import annotations

import contextlib
import json
import queue
import sys
import threading
import time
import traceback
from typing import Any

import bpy

lines: queue.SimpleQueue[str] = queue.SimpleQueue()
events: list[tuple[float, float, str]] = []
"""What `note` recorded: (seconds since 1970, processor seconds of Blender, text)."""


def note(text: str) -> None:
    """Record that something happened now."""
    events.append((time.time(), time.process_time(), text))


def manager() -> bpy.types.WindowManager:
    """Blender's window manager."""
    assert bpy.context.window_manager is not None
    return bpy.context.window_manager


def view() -> dict[str, Any]:
    """Window, area and region of the 3D view, for `temp_override`."""
    window = manager().windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    return {"window": window, "area": area, "region": part(area, "WINDOW")}


def call(operator: str, **values: object) -> None:
    """Run an operator over the 3D view; returns when it has finished."""
    group, name = operator.split(".")
    with bpy.context.temp_override(**view()):
        getattr(getattr(bpy.ops, group), name)(**values)


def part(area: bpy.types.Area, kind: str) -> bpy.types.Region:
    """A region of an area."""
    return next(r for r in area.regions if r.type == kind)


def sidebar() -> tuple[int, int, int, int]:
    """Left, top, width and height of the sidebar, pixels from the window's upper left corner."""
    found = view()
    region, window = part(found["area"], "UI"), found["window"]
    return region.x, window.height - region.y - region.height, region.width, region.height


def under_mouse() -> str:
    """The Python command of the button under the mouse, or a field's data path, or empty."""
    found = view()
    manager().clipboard = ""
    names = ("copy_python_command_button", "copy_data_path_button")
    with bpy.context.temp_override(**{**found, "region": part(found["area"], "UI")}):
        for button in (getattr(bpy.ops.ui, name) for name in names):
            if not manager().clipboard and button.poll():
                with contextlib.suppress(RuntimeError):
                    button()
    return str(manager().clipboard)


def file_browser() -> bpy.types.Area | None:
    """The area with an open file browser, in any window."""
    areas = (a for w in manager().windows for a in w.screen.areas if a.type == "FILE_BROWSER")
    return next(areas, None)


def answer() -> float:
    """Run the received code; a timer of Blender's calls this."""
    while not lines.empty():
        number, code = json.loads(lines.get())
        try:
            try:
                compiled = compile(code, "<driver>", "eval")
            except SyntaxError:
                exec(compile(code, "<driver>", "exec"), globals())
                value: object = None
            else:
                value = eval(compiled, globals())
            reply = [number, True, value]
        except Exception:
            reply = [number, False, traceback.format_exc()]
        print("@answer " + json.dumps(reply, default=str), flush=True)
    return 0.02


def read() -> None:
    """Put the lines of standard input into the queue; runs in a thread that ends with Blender."""
    for line in sys.stdin:
        lines.put(line)


threading.Thread(target=read, daemon=True).start()
bpy.app.timers.register(answer, first_interval=1.0, persistent=True)
