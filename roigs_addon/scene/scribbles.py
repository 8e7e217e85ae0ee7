"""The user's strokes on photos, for each box, saved in the .blend."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ..properties import object_props
from ..shared import scribbles, text

OBJECT, BACKGROUND = scribbles.OBJECT, scribbles.BACKGROUND


def strokes(roi: bpy.types.Object, photo: str) -> list[dict[str, Any]]:
    """Return the strokes on a photo in the form of a scribbles file, oldest first."""
    item = object_props(roi).scribbles.get(photo)
    try:
        found = text.parse_json(item.strokes.encode()) if item is not None else []
    except ValueError:
        return []
    return found if isinstance(found, list) else []


def add_stroke(
    roi: bpy.types.Object, photo: str, kind: str, width: float, points: list[tuple[float, float]]
) -> None:
    """Add a stroke: `points` and `width` in pixels of the photo."""
    drawn = strokes(roi, photo)
    rounded = [[round(x, 1), round(y, 1)] for x, y in points]
    drawn.append({"kind": kind, "width": round(width, 2), "points": rounded})
    item = object_props(roi).scribbles.get(photo)
    if item is None:
        item = object_props(roi).scribbles.add()
        item.name = photo
    item.strokes = json.dumps(drawn)


def clear(roi: bpy.types.Object, photo: str) -> int:
    """Remove the strokes on a photo; returns their number."""
    count, held = len(strokes(roi, photo)), object_props(roi).scribbles
    at = held.find(photo)
    if at >= 0:
        held.remove(at)
    return count


def photos(roi: bpy.types.Object) -> list[str]:
    """The photos with strokes for a box, by name."""
    return sorted(item.name for item in object_props(roi).scribbles if strokes(roi, item.name))


def document(roi: bpy.types.Object) -> dict[str, Any]:
    """Return the content of a scribbles file with one box's strokes."""
    records = [
        {"box": roi.name, "photo": photo, "strokes": strokes(roi, photo)} for photo in photos(roi)
    ]
    return {"scribbles": records}
