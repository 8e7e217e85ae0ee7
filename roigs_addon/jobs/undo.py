"""Makes undo steps for changes outside an operator, for which Blender makes none.

Without them, the change would become part of the next operator's step. Undoing that operator would
undo the change as well.
"""

from __future__ import annotations

import bpy

from .. import blender


def push(title: str) -> None:
    """Make an undo step; not in background mode, where nobody undoes anything."""
    window = bpy.context.window or next(iter(blender.windows()), None)
    if bpy.app.background or window is None:
        return
    with bpy.context.temp_override(window=window):
        bpy.ops.ed.undo_push(message=title)
