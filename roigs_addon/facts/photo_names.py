"""How many photos the scene has, and how the panel names them."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath

import bpy

from ..properties import scene_props
from ..scene import importing, lookup

Key = tuple[str, str, int]
"""Of what the facts were found in: another model, or other objects, and they are found again."""

_deleted: dict[Key, list[str]] = {}
_names: dict[Key, dict[str, str]] = {}


def count(scene: bpy.types.Scene) -> int:
    """How many photos the scene has."""
    return len(_short_names(scene))


def deleted(scene: bpy.types.Scene) -> list[str]:
    """Names of the imported photos whose cameras the user has deleted."""
    key = _key(scene)
    if key not in _deleted:
        _deleted.clear()
        _deleted[key] = importing.deleted_photos(scene)
    return _deleted[key]


def short_name(scene: bpy.types.Scene, photo: str) -> str:
    """A photo's file name without folders and suffix, if no other photo has the same."""
    return _short_names(scene).get(photo, photo)


def _short_names(scene: bpy.types.Scene) -> dict[str, str]:
    key = _key(scene)
    if key not in _names:
        _names.clear()
        _names[key] = shortened([*lookup.cameras(scene)])
    return _names[key]


def _key(scene: bpy.types.Scene) -> Key:
    props = scene_props(scene)
    return props.colmap, props.model_cache, len(scene.objects)


def shortened(photos: list[str]) -> dict[str, str]:
    """Photo -> its short name."""
    seen = Counter(PurePosixPath(photo).stem for photo in photos)
    paths = {photo: PurePosixPath(photo) for photo in photos}
    return {photo: p.stem if seen[p.stem] == 1 else photo for photo, p in paths.items()}


def forget() -> None:
    """Look again at the next question."""
    _names.clear()
    _deleted.clear()
