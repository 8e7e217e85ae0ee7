"""Masks of objects: their folders, and the photos that have one.

They are in the folder `masks` beside the photos, where the engine looks for them, or in the run
folder if `masks` cannot be written. The engine decides which of two masks of a photo is used
(`mask_record`).
"""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..geometry.photo import Photo
from ..shared import mask_record, run_files
from . import lookup, rois, scribbles

FOLDER = "masks"


def folder(scene: bpy.types.Scene, run: Path) -> Path:
    """Return the folder in which masks are made: beside the photos, or in the run folder.

    The run folder is used if the other cannot be written, and from then on while it has masks.

    Args:
        scene: with a model.
        run: the scene's run folder.
    """
    beside = _beside_photos(scene)
    if beside is not None and in_run(run) is None:
        there = beside if os.path.isdir(beside) else beside.parent
        if os.access(there, os.W_OK):
            return beside
    return run / run_files.OBJECT_MASKS


def in_run(run: Path) -> Path | None:
    """Return the folder of masks in the run folder; None if it has no masks."""
    there = run / run_files.OBJECT_MASKS
    try:
        return there if any(there.iterdir()) else None
    except OSError:
        return None


def folders(scene: bpy.types.Scene, run: Path) -> list[Path]:
    """Return the folders that can have masks."""
    beside = _beside_photos(scene)
    return [*([] if beside is None else [beside]), run / run_files.OBJECT_MASKS]


def of_box(root: Path, roi: bpy.types.Object) -> Path:
    """Return the folder of a box's masks; AddonError: the box's name is no valid file name."""
    return mask_record.box_folders(root, rois.file_name(roi))[0]


def are_there(scene: bpy.types.Scene, run: Path) -> bool:
    """Whether any box has masks that training will use."""
    roots = folders(scene, run)
    named = [roi for roi in lookup.rois(scene) if rois.has_file_name(roi)]
    return any(os.path.isdir(of_box(root, roi)) for root in roots for roi in named)


def file(scene: bpy.types.Scene, run: Path, roi: bpy.types.Object, photo: str) -> Path | None:
    """Return the mask of a photo that training uses; None if there is none."""
    if not rois.has_file_name(roi):
        return None
    *beside, in_run = [of_box(root, roi) for root in folders(scene, run)]
    theirs = [folder / mask_record.mask_name(photo) for folder in (*beside, in_run)]
    *first, last = [file if os.path.isfile(file) else None for file in theirs]
    return mask_record.used_mask(first[0], last, beside[0]) if first else last


def photos(scene: bpy.types.Scene, run: Path, roi: bpy.types.Object) -> list[str]:
    """The photos with a mask or strokes for a box, by name."""
    drawn = set(scribbles.photos(roi))
    names = sorted(lookup.cameras(scene))
    return [n for n in names if n in drawn or file(scene, run, roi, n) is not None]


def photo_at_hand(context: bpy.types.Context) -> Photo | None:
    """Return the photo of the scene's camera; None if it is not a photo's camera."""
    scene = context.scene
    camera = scene.camera if scene is not None else None
    if camera is None or not lookup.is_photo_camera(camera):
        return None
    return lookup.photo_record(camera)


def size_of(photo: Photo) -> tuple[int, int]:
    """Return width and height of a photo's file; of its camera, if an old .blend lacks the size."""
    if photo.lens_size is not None:
        return photo.lens_size
    for image in bpy.data.images:
        if image.filepath and bpy.path.abspath(image.filepath) == photo.path and image.size[0]:
            return image.size[0], image.size[1]
    return photo.intrinsics.width, photo.intrinsics.height


def _beside_photos(scene: bpy.types.Scene) -> Path | None:
    """Return the folder `masks` beside the photos; None if no photo's path is known."""
    at_hand = [scene.camera] if scene.camera and lookup.is_photo_camera(scene.camera) else []
    for camera in at_hand or lookup.cameras(scene).values():
        photo = lookup.photo_record(camera)
        if photo is not None and photo.path:
            above = len(Path(photo.name).parts)  # number of levels up to the photos' folder
            parents = Path(photo.path).parents
            if len(parents) > above:
                return parents[above] / FOLDER
    return None
