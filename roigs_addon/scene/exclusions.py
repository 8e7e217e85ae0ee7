"""Photos that the user excludes from selection and training, by name or by deleting cameras.

Hiding a camera excludes nothing: users hide all cameras only to see the model.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..properties import scene_props
from . import importing, lookup, selections


def excluded(scene: bpy.types.Scene) -> list[str]:
    """Names of the imported photos that are not used."""
    chosen = {item.name for item in scene_props(scene).excluded}
    return sorted(chosen.intersection(lookup.cameras(scene)).union(importing.deleted_photos(scene)))


def is_excluded(scene: bpy.types.Scene, photo: str) -> bool:
    """Whether the user excluded a photo that has a camera; fast enough for a list."""
    return photo in scene_props(scene).excluded


def exclude(scene: bpy.types.Scene, photos: Iterable[str]) -> None:
    """Exclude these photos; boxes keep them in their lists."""
    for photo in photos:
        if not is_excluded(scene, photo):
            scene_props(scene).excluded.add().name = photo
    selections.mark_chosen(scene)


def include(scene: bpy.types.Scene, photos: Iterable[str]) -> None:
    """Use these photos again; deleted cameras come back.

    Raises:
        AddonError: they cannot, because their parent is deleted.
    """
    chosen, names = scene_props(scene).excluded, set(photos)
    for at in reversed(range(len(chosen))):
        if chosen[at].name in names:
            chosen.remove(at)
    importing.restore_cameras(scene, names)
    selections.mark_chosen(scene)
