"""Undo steps for what changes a scene outside of an operator: Blender makes none of its own then.

Without them, the next operator's step is the first to hold the change, and undoing that operator
takes the change with it.
"""

from __future__ import annotations

import bpy


def push(title: str) -> None:
    """Make a step; in the background nobody undoes anything."""
    window = bpy.context.window or next(iter(bpy.context.window_manager.windows), None)
    if bpy.app.background or window is None:
        return
    with bpy.context.temp_override(window=window):
        bpy.ops.ed.undo_push(message=title)
