"""Shows suggested photos as numbered cameras at the places for the next photos.

They are in a separate collection, with a line from each to its box. A preview is the background of
each camera, like the photo of an imported camera.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy

from ..blender import camera_of
from ..errors import AddonError
from ..geometry.photo import Photo
from ..properties import object_props, scene_props
from ..shared import files, text
from . import backgrounds, cameras, lookup

COLLECTION = "Suggested Photos"
MARK = "roigs_suggested"
"""Custom property of that collection."""
COLOUR = (1.0, 0.63, 0.0, 1.0)
CAMERA_SIZE = 0.1
"""Display size of a camera if there is no photo's camera to copy it from."""


@dataclass(frozen=True, kw_only=True)
class Suggestion:
    """Record of a suggested photo.

    Attributes:
        number: rank within its box, from 1, the best first.
        gain: expected reduction of the error, dB.
        known: share of the box that photos cover with it, 0 to 1.
    """

    box: str
    number: int
    gain: float
    known: float
    words: str

    @classmethod
    @lru_cache(maxsize=1 << 10)
    def from_json(cls, line: str) -> Suggestion | None:
        """Parse an object's property; None if it holds no suggestion."""
        try:
            return cls.from_dict(text.parse_json(line.encode()))
        except (ValueError, KeyError, TypeError, OverflowError):
            return None

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Suggestion:
        """Parse a camera of the engine's `suggestions.json`."""
        return cls(
            box=str(record["box"]),
            number=int(record["number"]),
            gain=float(record["gain"]),
            known=float(record["known"]),
            words=str(record["words"]),
        )


def show(scene: bpy.types.Scene, listed: Path) -> int:
    """Show the suggestions of the engine's list, in place of earlier ones; return their number.

    Raises:
        AddonError: the list cannot be read, or the model's root is deleted.
    """
    root: bpy.types.Object | None = scene_props(scene).root
    if root is None:
        raise AddonError("The empty of the COLMAP model is deleted. Import the model again.")
    try:
        records = text.parse_json(files.read_bytes(listed))["cameras"]
        pairs = [(Suggestion.from_dict(each), _photo(each, listed.parent)) for each in records]
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise AddonError(f"The suggestions are unreadable ({error}).") from error
    remove(scene)
    collection = bpy.data.collections.new(COLLECTION)
    collection[MARK] = True
    scene.collection.children.link(collection)
    size = _size(scene)
    for suggestion, photo in pairs:
        item = cameras.new_camera(photo, size)
        item.name = f"{suggestion.number} {suggestion.box}"
        item.show_name, item.color, item.parent = True, COLOUR, root
        props = object_props(item)
        props.kind, props.suggestion = "SHOT", json.dumps(vars(suggestion))
        collection.objects.link(item)
        backgrounds.show(camera_of(item), photo)
    for box in dict.fromkeys(suggestion.box for suggestion, _ in pairs):
        roi = next((roi for roi in lookup.rois(scene) if roi.name == box), None)
        if roi is not None:
            own = [photo for suggestion, photo in pairs if suggestion.box == box]
            collection.objects.link(_lines(root, roi, own))
    cameras.fit_clips(scene, lookup.root_scale(scene))
    return len(pairs)


def of_box(scene: bpy.types.Scene, roi: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the suggested cameras of a box, the best first."""
    found = [(known.number, item) for item, known in _all(scene) if known.box == roi.name]
    return [item for _, item in sorted(found, key=lambda pair: pair[0])]


def are_there(scene: bpy.types.Scene) -> bool:
    """Whether the scene has suggested photos."""
    return bool(_collections(scene))


def known_of(item: bpy.types.Object) -> Suggestion | None:
    """Return the record of a suggested photo; None if the object is not one."""
    return Suggestion.from_json(object_props(item).suggestion)


def remove(scene: bpy.types.Scene) -> None:
    """Remove all suggested photos, their pictures and lines."""
    for collection in _collections(scene):
        items = list(collection.objects)
        data: set[Any] = {item.data for item in items}
        images = {
            background.image
            for item in items
            if item.type == "CAMERA"
            for background in camera_of(item).background_images
        }
        bpy.data.batch_remove(items)
        bpy.data.batch_remove([block for block in data if block is not None and not block.users])
        bpy.data.batch_remove([image for image in images if image and not image.users])
        bpy.data.collections.remove(collection)


def _all(scene: bpy.types.Scene) -> list[tuple[bpy.types.Object, Suggestion]]:
    shots = ((item, known_of(item)) for item in lookup.of_kind(scene, "SHOT"))
    return [(item, known) for item, known in shots if known is not None]


def _collections(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    return [c for c in scene.collection.children if c.get(MARK) is not None]


def _photo(record: dict[str, Any], folder: Path) -> Photo:
    """Return a suggested camera as a photo; its file is the preview."""
    return Photo.from_dict(record | {"path": str(folder / record["picture"])})


def _size(scene: bpy.types.Scene) -> float:
    """Return the display size of cameras: that of the photos' cameras."""
    photo = next(lookup.of_kind(scene, "CAMERA"), None)
    return camera_of(photo).display_size if photo is not None else CAMERA_SIZE


def _lines(
    root: bpy.types.Object, roi: bpy.types.Object, photos: Sequence[Photo]
) -> bpy.types.Object:
    """Create lines from each photo's place to the middle of the box, in the COLMAP frame."""
    eyes = [-photo.pose[:3, :3].T @ photo.pose[:3, 3] for photo in photos]
    inverse = lookup.inverse(lookup.matrix_world(root), root.name)
    middle = (inverse @ lookup.matrix_world(roi))[:3, 3]
    mesh = bpy.data.meshes.new(f"{roi.name} Lines")
    points = [middle.tolist(), *(eye.tolist() for eye in eyes)]
    mesh.from_pydata(points, [(0, number) for number in range(1, len(points))], [])
    item = bpy.data.objects.new(mesh.name, mesh)
    item.parent, item.color, item.hide_render, item.hide_select = root, COLOUR, True, True
    return item
