"""The check of each box's photos: what they cover, and which of them may be bad.

The engine computes it together with its suggestions. Each box stores its own part, so undo and the
.blend include it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..errors import AddonError
from ..geometry.frames import Matrix
from ..properties import object_props, scene_props
from ..shared import files, text
from . import lookup, rois

STEEP = float(np.sqrt(0.5))
"""A unit vector this high or higher points upwards: 45 degrees."""
NORMALS = {
    f"{sign}{axis}": (row, float(f"{sign}1")) for row, axis in enumerate("xyz") for sign in "-+"
}
"""Side of a box, as the engine names it -> axis of the box, and sign of the side's normal."""

Fault = tuple[str, str, str]
"""A doubtful photo: its name, the reason in a word or two, the reason with its figure."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """The check of one box's photos.

    Attributes:
        place: the box's place at the check, see `rois.place_key`.
        made: digest of the request and of the engine's answer.
        of: number of photos in the scene at the check.
        pixels: along its longest side.
        exposure_spread: stops between the darkest photo and the brightest; 0: not measured.
        known: share that the photos cover, 0 to 1.
        later: the same with the suggested photos.
        suggested: number of these.
        without_photos: sides that no photo looks at, see `NORMALS`.
    """

    place: str
    made: str
    of: int
    pixels: float
    exposure_spread: float
    known: float
    later: float
    suggested: int
    without_photos: tuple[str, ...]
    faults: tuple[Fault, ...]

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Checked:
        """From JSON; raises ValueError, KeyError, TypeError or OverflowError."""
        known, later, pixels = (float(record[key]) for key in ("known", "later", "pixels"))
        spread = float(record.get("exposure_spread", 0.0))  # older files lack it
        shares, sizes = (known, later), (pixels, spread)
        if not (all(0 <= x <= 1 for x in shares) and all(0 <= x < np.inf for x in sizes)):
            raise ValueError("no such figures")
        return cls(
            place=str(record["place"]),
            made=str(record["made"]),
            of=int(record["of"]),
            pixels=pixels,
            exposure_spread=spread,
            known=known,
            later=later,
            suggested=int(record["suggested"]),
            without_photos=tuple(side for side in record["without_photos"] if side in NORMALS),
            faults=tuple((str(a), str(b), str(c)) for a, b, c in record["faults"]),
        )


def places_of(boxes: list[bpy.types.Object], scene: bpy.types.Scene) -> dict[str, str]:
    """Name -> place of each box, for `take`; raises AddonError if one is not a box."""
    return {box.name: rois.place_key(box, scene) for box in boxes}


def take(scene: bpy.types.Scene, places: Mapping[str, str], listed: Path, request: str) -> None:
    """Store in each box its part of the engine's list of suggestions.

    Args:
        scene: with the boxes.
        places: of the boxes at the time of the request; other boxes are left alone.
        listed: the list's file.
        request: digest of the request to the engine.

    Raises:
        AddonError: the list cannot be read.
    """
    try:
        data = files.read_bytes(listed)
        whole = text.parse_json(data)
        made = _made(request, data)
        found = {
            str(box["name"]): _from_engine(box, whole["cameras"], made) for box in whole["boxes"]
        }
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise AddonError(f"The suggestions are unreadable ({error}).") from error
    every = len(lookup.cameras(scene))
    for roi in lookup.rois(scene):
        if roi.name in found and roi.name in places:
            record = found[roi.name] | {"place": places[roi.name], "of": every}
            object_props(roi).checked = json.dumps(record)


def of_box(roi: bpy.types.Object) -> Checked | None:
    """Return the check of a box's photos; None if they were not checked."""
    return _parsed(object_props(roi).checked)


def is_stale(roi: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Whether the box was moved after its photos were checked."""
    found = of_box(roi)
    try:
        return found is not None and found.place != rois.place_key(roi, scene)
    except AddonError:
        return True


def is_fresh(scene: bpy.types.Scene, listed: Path, request: str) -> bool:
    """Whether all boxes store this list of suggestions, made for this request."""
    try:
        made = _made(request, files.read_bytes(listed))
    except OSError:
        return False
    found = map(of_box, lookup.rois(scene))
    return all(known is not None and known.made == made for known in found)


def faults_of(roi: bpy.types.Object) -> tuple[Fault, ...]:
    """Return the doubtful photos of a box."""
    found = of_box(roi)
    return () if found is None else found.faults


def sides_without_photos(roi: bpy.types.Object, scene: bpy.types.Scene) -> list[str]:
    """Name these sides: 'above', 'below', or by Blender's names of the box's axes."""
    found = of_box(roi)
    if found is None or not found.without_photos:
        return []
    try:
        axes = lookup.box(roi, scene).world_to_box[:3, :3]
    except AddonError:
        return []
    to_world = lookup.matrix_world(scene_props(scene).root)[:3, :3]
    own = lookup.matrix_world(roi)[:3, :3]
    sides = [NORMALS[side] for side in found.without_photos]
    normals = [sign * to_world @ axes[row] for row, sign in sides]
    return [_in_words(normal, own) for normal in normals]


def _in_words(normal: Matrix, own: Matrix) -> str:
    """Name a side by its normal in the world; the columns of `own` (3, 3) are the box's axes."""
    rise = normal[2] / max(float(np.linalg.norm(normal)), 1e-300)
    if abs(rise) >= STEEP:
        return "above" if rise > 0 else "below"
    along = normal @ own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    axis = int(np.abs(along).argmax())
    return f"its {'+' if along[axis] > 0 else '-'}{'XYZ'[axis]} side"


def _from_engine(box: dict[str, Any], cameras: list[dict[str, Any]], made: str) -> dict[str, Any]:
    """Convert a box of the engine's list to a record; place and photo count are set later."""
    values = [float(camera["known"]) for camera in cameras if camera["box"] == box["name"]]
    record = {
        "place": "",
        "of": 0,
        "made": made,
        "later": max(values, default=box["known"]),
        "suggested": len(values),
        "faults": [(fault["photo"], fault["reason"], fault["text"]) for fault in box["faults"]],
    }
    copied = {key: box[key] for key in ("pixels", "exposure_spread", "known", "without_photos")}
    return asdict(Checked.from_dict(record | copied))


def _made(request: str, data: bytes) -> str:
    return text.json_digest([request, data.decode("utf-8", "replace")])


@lru_cache(maxsize=1 << 8)
def _parsed(line: str) -> Checked | None:
    try:
        return Checked.from_dict(text.parse_json(line.encode()))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None
