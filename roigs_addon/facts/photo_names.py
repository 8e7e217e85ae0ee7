"""Counts the scene's photos, and shortens their names for the panel."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath

import bpy

from ..properties import scene_props
from ..scene import exclusions, lookup

Key = tuple[int, str, str, int, tuple[str, ...]]
"""State of the scene that the cached facts belong to."""

LONG = 10
"""Longest name in letters that fits into a sidebar of Blender's usual width."""
SHOWN_TWICE = 2
"""Common letters kept before the first difference if a word is cut."""

_excluded: dict[Key, list[str]] = {}
_names: dict[Key, dict[str, str]] = {}


def count(scene: bpy.types.Scene) -> int:
    """Number of photos in the scene."""
    return len(_short_names(scene))


def excluded(scene: bpy.types.Scene) -> list[str]:
    """Names of the imported photos that the user has excluded."""
    key = _key(scene)
    if key not in _excluded:
        _excluded.clear()
        _excluded[key] = exclusions.excluded(scene)
    return _excluded[key]


def short_name(scene: bpy.types.Scene, photo: str) -> str:
    """Return the part of a photo's name that differs from the others: a sidebar is narrow."""
    return _short_names(scene).get(photo, photo)


def _short_names(scene: bpy.types.Scene) -> dict[str, str]:
    key = _key(scene)
    if key not in _names:
        _names.clear()
        _names[key] = shortened([*lookup.cameras(scene)])
    return _names[key]


def _key(scene: bpy.types.Scene) -> Key:
    props = scene_props(scene)
    chosen = tuple(item.name for item in props.excluded)
    return scene.session_uid, props.colmap, props.model_cache, len(scene.objects), chosen


def shortened(photos: list[str]) -> dict[str, str]:
    """Return photo -> file name without suffix, with the folder if another photo has this name.

    Names that are too long for a narrow sidebar lose their common parts.
    """
    paths = {photo: PurePosixPath(photo) for photo in photos}
    seen = Counter(path.stem for path in paths.values())
    alike = [path for path in paths.values() if seen[path.stem] > 1]
    stems = _distinct_parts({stem for stem in seen if len(stem) > LONG or seen[stem] > 1})
    folders = _distinct_parts({str(path.parent) for path in alike})
    short = {
        photo: f"{folders[str(path.parent)]}/{stems[path.stem]}"
        if seen[path.stem] > 1
        else stems.get(path.stem, path.stem)
        for photo, path in paths.items()
    }
    return short if len(set(short.values())) == len(short) else {photo: photo for photo in photos}


def _distinct_parts(names: set[str]) -> dict[str, str]:
    """Return name -> its part without common first words and, if still too long, common last words.

    If that is too long, names are cut within a word: their common start, or all but their end.
    """
    if len(names) < 2:
        return {name: name for name in names}
    ordered = sorted(names)
    start = _words(_common_start(ordered))
    parts = {name: name[len(start) :] for name in ordered}
    if _longest(parts) > LONG:
        end = len(_words(_common_start([part[::-1] for part in parts.values()])))
        parts = {name: part[: len(part) - end] for name, part in parts.items()}
    if _longest(parts) > LONG:
        same = len(_common_start(ordered)) - SHOWN_TWICE
        parts = {name: f"…{name[max(same, 0) :]}" for name in ordered}
    if _longest(parts) > LONG:
        parts = {name: f"…{name[-LONG:]}" for name in ordered}
    return parts if len(set(parts.values())) == len(parts) else {name: name for name in names}


def _common_start(names: list[str]) -> str:
    first, last = min(names), max(names)
    same = (at for at, (a, b) in enumerate(zip(first, last, strict=False)) if a != b)
    return first[: next(same, min(len(first), len(last)))]


def _words(text: str) -> str:
    """Return a text up to its last separator, without an incomplete word or number at its end."""
    return text.rstrip("".join(filter(str.isalnum, text)))


def _longest(parts: dict[str, str]) -> int:
    return max(map(len, parts.values()))


def forget() -> None:
    """Clear the cache."""
    _names.clear()
    _excluded.clear()
