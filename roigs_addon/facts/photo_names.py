"""How many photos the scene has, and how the panel names them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path, PurePosixPath

import bpy

from ..errors import AddonError
from ..properties import scene_props
from ..scene import importing, lookup

_imported: dict[str, int] = {}
_names: dict[tuple[str, str, int], dict[str, str]] = {}


def count(scene: bpy.types.Scene) -> int:
    """How many photos the scene has."""
    return len(_short_names(scene))


def deleted(scene: bpy.types.Scene) -> int:
    """How many of the imported photos' cameras the user has deleted."""
    props = scene_props(scene)
    if props.model_cache not in _imported:
        _imported.clear()
        try:
            _imported[props.model_cache] = len(importing.photo_names(Path(props.model_cache)))
        except AddonError:
            _imported[props.model_cache] = 0
    return max(0, _imported[props.model_cache] - count(scene))


def short_name(scene: bpy.types.Scene, photo: str) -> str:
    """A photo's file name without folders and suffix, if no other photo has the same."""
    return _short_names(scene).get(photo, photo)


def _short_names(scene: bpy.types.Scene) -> dict[str, str]:
    props = scene_props(scene)
    key = (props.colmap, props.model_cache, len(scene.objects))
    if key not in _names:
        _names.clear()
        _names[key] = shortened([*lookup.cameras(scene)])
    return _names[key]


def shortened(photos: list[str]) -> dict[str, str]:
    """Photo -> its short name."""
    seen = Counter(PurePosixPath(photo).stem for photo in photos)
    paths = {photo: PurePosixPath(photo) for photo in photos}
    return {photo: p.stem if seen[p.stem] == 1 else photo for photo, p in paths.items()}


def forget() -> None:
    """Look again at the next question."""
    _names.clear()
    _imported.clear()
