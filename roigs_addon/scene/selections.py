"""The photos that train each box: the list of a box, and its display in the scene."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy

from ..errors import AddonError
from ..geometry.photo import Photo
from ..properties import object_props, scene_props
from ..shared import files, text
from . import lookup, rois

CHOSEN_COLOUR = (0.1, 0.8, 0.3, 1.0)
PLAIN_COLOUR = (1.0, 1.0, 1.0, 1.0)
EXCLUDED_COLOUR = (0.85, 0.25, 0.2, 1.0)
CHOSEN_FOR = "roigs_chosen_for"
"""Custom property that marks the collection of a box's photos; its value is the box's name."""


def take_selection(roi: bpy.types.Object, scene: bpy.types.Scene, path: Path) -> None:
    """Give a box the photos that the engine selected.

    Raises:
        AddonError: the engine's file cannot be read.
    """
    try:
        record = text.parse_json(files.read_bytes(path))
        names = [str(name) for name in record["names"]]
        scores = [float(score) for score in record.get("scores") or [0.0] * len(names)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise AddonError(f"The selection of '{roi.name}' is unreadable ({error}).") from error
    props = object_props(roi)
    props.selection.clear()
    for name, score in zip(names, scores, strict=False):
        item = props.selection.add()
        item.name, item.score = name, score
    props.selection_index = 0
    props.selected_box = rois.place_key(roi, scene)
    mark_chosen(scene)


def is_stale(roi: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Whether the box was moved after its photos were selected."""
    try:
        return object_props(roi).selected_box not in ("", rois.place_key(roi, scene))
    except AddonError:
        return True


def add_photos(roi: bpy.types.Object, names: Iterable[str]) -> None:
    """Add photos to a box's list that are not in it yet."""
    selection = object_props(roi).selection
    present = {item.name for item in selection}
    for name in names:
        if name not in present:
            selection.add().name = name


def mark_chosen(scene: bpy.types.Scene) -> None:
    """Colour selected and excluded cameras, and collect the selected ones of each box."""
    found = lookup.cameras(scene)
    chosen_by_any: set[str] = set()
    in_use: set[bpy.types.Collection] = set()
    for roi in lookup.rois(scene):
        names = {item.name for item in object_props(roi).selection} & set(found)
        chosen_by_any |= names
        if names:
            collection = _collection(scene, roi.name)
            for item in set(collection.objects) - {found[name] for name in names}:
                collection.objects.unlink(item)
            for name in names - {photo.name for photo in photos_of(collection.objects)}:
                collection.objects.link(found[name])
            in_use.add(collection)
    for collection in set(_collections(scene)) - in_use:  # box gone, renamed or without photos
        bpy.data.collections.remove(collection)
    excluded = {item.name for item in scene_props(scene).excluded}
    for name, camera in found.items():
        chosen = CHOSEN_COLOUR if name in chosen_by_any else PLAIN_COLOUR
        camera.color = EXCLUDED_COLOUR if name in excluded else chosen


def photos_of(items: Iterable[bpy.types.Object]) -> list[Photo]:
    """The photos of the cameras among some objects."""
    records = (lookup.photo_record(item) for item in items)
    return [photo for photo in records if photo]


def _collections(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    return [c for c in scene.collection.children if c.get(CHOSEN_FOR) is not None]


def _collection(scene: bpy.types.Scene, roi: str) -> bpy.types.Collection:
    """Return the collection of a box's photos, created if there is none."""
    for collection in _collections(scene):
        if collection[CHOSEN_FOR] == roi:
            return collection
    collection = bpy.data.collections.new(f"{roi} Photos")
    collection[CHOSEN_FOR] = roi
    scene.collection.children.link(collection)
    return collection
