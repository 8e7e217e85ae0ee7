"""Finds the add-on's objects in a scene."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from .errors import AddonError
from .frames import Box, Matrix, ShearedBoxError, box_from_matrix
from .photo import Photo

TYPES = {
    "ROOT": {"EMPTY"},
    "CAMERA": {"CAMERA"},
    "POINTS": {"MESH"},
    "ROI": {"EMPTY"},
    "SPLATS": {"MESH", "POINTCLOUD"},  # the latter from native.py
}
"""What Blender calls the objects of each kind; it is asked first, being three times as fast."""


def of_kind(scene: bpy.types.Scene, kind: str) -> Iterator[bpy.types.Object]:
    """The scene's objects of a kind, in the order of their names."""
    types = TYPES[kind]
    found = (o for o in scene.objects if o.type in types and o.roigs.kind == kind)
    return iter(sorted(found, key=lambda o: o.name))


def rois(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The boxes."""
    return list(of_kind(scene, "ROI"))


def active_roi(context: bpy.types.Context) -> bpy.types.Object | None:
    """The box that is active in the panel's list; the first one when none was made so."""
    boxes, active = rois(context.scene), context.scene.roigs.active_roi
    return active if active in boxes else next(iter(boxes), None)


def cameras(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Photo name -> camera object: the first by name, before its copies."""
    found: dict[str, bpy.types.Object] = {}
    for camera in of_kind(scene, "CAMERA"):
        photo = Photo.from_json(camera.roigs.photo)
        if photo is not None:
            found.setdefault(photo.name, camera)
    return found


def camera_at_hand(context: bpy.types.Context) -> bpy.types.Object | None:
    """The camera of a photo that is the active object, else the scene's active camera."""
    items = context.active_object, context.scene.camera
    return next((i for i in items if i is not None and i.roigs.kind == "CAMERA"), None)


def named_cameras(scene: bpy.types.Scene, photos: set[str]) -> list[bpy.types.Object]:
    """The camera objects of some photos, quickly: by the objects' names, which are the photos'
    unless these are long or not unique."""
    found = (scene.objects.get(name) for name in photos)
    return [item for item in found if item is not None and item.roigs.kind == "CAMERA"]


def points(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The sparse points."""
    return next(of_kind(scene, "POINTS"), None)


def splats(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The trained Gaussians."""
    return list(of_kind(scene, "SPLATS"))


def matrix_world(item: bpy.types.Object | None) -> Matrix:
    """An object's `matrix_world`; the identity when there is none."""
    return np.eye(4) if item is None else np.array(item.matrix_world, dtype=np.float64)


def _with_root(item: bpy.types.Object, root: bpy.types.Object | None) -> tuple[Matrix, Matrix]:
    """Matrices of an object and of the root, in any frame that both share.

    For a child of the root that is the root's own frame: its numbers stay the same to the last
    digit wherever the root goes, which those of `matrix_world` do not.
    """
    child = root is not None and item.parent == root and item.parent_type == "OBJECT"
    if child and not item.constraints:
        local = np.array(item.matrix_parent_inverse, float) @ np.array(item.matrix_basis, float)
        return local, np.eye(4)
    return matrix_world(item), matrix_world(root)


def box(roi: bpy.types.Object, scene: bpy.types.Scene) -> Box:
    """A ROI's box in the COLMAP frame.

    Raises:
        AddonError: the empty is no box.
    """
    try:
        return box_from_matrix(*_with_root(roi, scene.roigs.root), roi.empty_display_size)
    except ShearedBoxError as error:
        raise AddonError(
            f"«{roi.name}» is slanted: {error}. Scale its root evenly, or clear the box's rotation."
        ) from error
    except (ValueError, np.linalg.LinAlgError) as error:
        raise AddonError(
            f"«{roi.name}» has no volume. Give it a size on all three axes."
        ) from error
