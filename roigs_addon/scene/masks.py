"""Masks of objects: where they are, and which photos have one."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..engine import own_files
from ..geometry.photo import Photo
from . import lookup, rois, scribbles

FOLDER = "masks"
"""Beside the folder of the photos, as the engine looks for them."""


def folder(scene: bpy.types.Scene, run: Path) -> Path:
    """The folder of all masks: beside the photos, or in the run folder if nothing can be written.

    Args:
        scene: with a model.
        run: the scene's run folder.
    """
    beside = _beside_photos(scene)
    if beside is not None:
        there = beside if os.path.isdir(beside) else beside.parent
        if os.access(there, os.W_OK):
            return beside
    return run / own_files.OWN / own_files.MASKS


def of_box(root: Path, roi: bpy.types.Object) -> Path:
    """The folder of a box's masks."""
    return root / rois.file_name(roi)


def are_there(scene: bpy.types.Scene, run: Path) -> bool:
    """Whether any box has masks that training will use."""
    root = folder(scene, run)
    return any(os.path.isdir(of_box(root, roi)) for roi in lookup.rois(scene))


def file(root: Path, roi: bpy.types.Object, photo: str) -> Path:
    """The mask of a photo, whether it is there or not."""
    return of_box(root, roi) / f"{photo}.png"


def photos(scene: bpy.types.Scene, root: Path, roi: bpy.types.Object) -> list[str]:
    """The photos with a mask or strokes for a box, by name."""
    drawn = set(scribbles.photos(roi))
    names = sorted(lookup.cameras(scene))
    return [n for n in names if n in drawn or os.path.isfile(file(root, roi, n))]


def photo_at_hand(context: bpy.types.Context) -> Photo | None:
    """The photo whose camera the scene looks through."""
    scene = context.scene
    camera = scene.camera if scene is not None else None
    if camera is None or not lookup.is_photo_camera(camera):
        return None
    return lookup.photo_record(camera)


def size_of(photo: Photo) -> tuple[int, int]:
    """Width and height of a photo's file, if it is loaded; else of its camera."""
    for image in bpy.data.images:
        if image.filepath and bpy.path.abspath(image.filepath) == photo.path and image.size[0]:
            return image.size[0], image.size[1]
    return photo.intrinsics.width, photo.intrinsics.height


def _beside_photos(scene: bpy.types.Scene) -> Path | None:
    """The folder `masks` beside the photos; None: no photo is known."""
    at_hand = [scene.camera] if scene.camera and lookup.is_photo_camera(scene.camera) else []
    for camera in at_hand or lookup.cameras(scene).values():
        photo = lookup.photo_record(camera)
        if photo is not None and photo.path:
            above = len(Path(photo.name).parts)  # the photos' folder is so many levels up
            parents = Path(photo.path).parents
            if len(parents) > above:
                return parents[above] / FOLDER
    return None
