"""Thumbnails of photos for the panels.

Blender reads a photo in a thread when its thumbnail is first drawn, and keeps the thumbnail in the
system's cache. So a panel that shows one photo at a time never waits.
"""

from __future__ import annotations

from typing import Any

import bpy
import bpy.utils.previews

from ..blender import is_plain_file
from ..scene import lookup

MOST = 100
"""Most thumbnails kept: more than a user looks at in a while."""

_pictures: Any = None


def icon(scene: bpy.types.Scene, photo: str) -> int:
    """Return Blender's icon number of a photo's thumbnail; 0 if its file is unknown."""
    global _pictures
    camera = next(iter(lookup.named_cameras(scene, {photo})), None)
    record = lookup.photo_record(camera) if camera else None
    if record is None or not is_plain_file(record.path):
        return 0
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    if record.path not in _pictures:
        if len(_pictures) >= MOST:
            _pictures.clear()
        _pictures.load(record.path, record.path, "IMAGE")
    return int(_pictures[record.path].icon_id)


def forget() -> None:
    """Free the thumbnails."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _pictures = None
