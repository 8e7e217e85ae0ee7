"""How many photos the scene has, and how the panel names them."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath

import bpy

from ..properties import scene_props
from ..scene import exclusions, lookup

Key = tuple[str, str, int, int]
"""Of what the facts were found in: another model, or other objects, and they are found again."""

_excluded: dict[Key, int] = {}
_names: dict[Key, dict[str, str]] = {}


def count(scene: bpy.types.Scene) -> int:
    """How many photos the scene has."""
    return len(_short_names(scene))


def excluded(scene: bpy.types.Scene) -> int:
    """How many of the imported photos the user has excluded."""
    key = _key(scene)
    if key not in _excluded:
        _excluded.clear()
        _excluded[key] = len(exclusions.excluded(scene))
    return _excluded[key]


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
    return props.colmap, props.model_cache, len(scene.objects), len(props.excluded)


def shortened(photos: list[str]) -> dict[str, str]:
    """Photo -> its short name."""
    seen = Counter(PurePosixPath(photo).stem for photo in photos)
    paths = {photo: PurePosixPath(photo) for photo in photos}
    return {photo: p.stem if seen[p.stem] == 1 else photo for photo, p in paths.items()}


def forget() -> None:
    """Look again at the next question."""
    _names.clear()
    _excluded.clear()
