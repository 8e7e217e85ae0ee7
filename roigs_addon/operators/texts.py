"""Opens the engine's files in Blender's text editor."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import blender
from ..shared import files

LAST_LINES = 20
"""How many lines are visible of a text that is opened at its end."""


def show(name: str, path: Path, *, end: bool = False) -> None:
    """Load a file as a text; show it in an open text editor, else in a new window.

    Args:
        name: of the text in Blender; an earlier one of that name is replaced.
        path: the file.
        end: whether to show its last lines.
    """
    text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
    text.from_string(files.read_bytes(path).decode("utf-8", "replace"))
    if bpy.app.background:
        return
    editor = next(blender.areas("TEXT_EDITOR"), None) or _new_editor()
    space = editor.spaces.active
    if isinstance(space, bpy.types.SpaceTextEditor):
        space.text, space.show_word_wrap = text, True
        space.top = max(0, len(text.lines) - LAST_LINES) if end else 0


def _new_editor() -> bpy.types.Area:
    bpy.ops.wm.window_new()
    area = blender.windows()[-1].screen.areas[0]
    area.type = "TEXT_EDITOR"
    return area
