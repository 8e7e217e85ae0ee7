"""Finds the add-on's objects in a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

import bpy
import numpy as np

from ..blender import scene_of
from ..errors import AddonError
from ..geometry.box import Box, ShearedBoxError, box_from_matrix
from ..geometry.frames import Matrix
from ..geometry.photo import Photo
from ..properties import object_props, scene_props
from ..shared import transforms

TYPES = {
    "ROOT": {"EMPTY"},
    "CAMERA": {"CAMERA"},
    "POINTS": {"MESH"},
    "ROI": {"EMPTY"},
    "SPLATS": {"MESH"},
    "SURFACE": {"MESH"},
    "PROXY": {"MESH"},
    "SHOT": {"CAMERA"},
}
"""Blender's types of the objects of each kind; checked first, which is three times as fast."""

FAR = 1e15
"""As for boxes and placements."""


def of_kind(scene: bpy.types.Scene, kind: str) -> Iterator[bpy.types.Object]:
    """The scene's objects of a kind, in the order of their names."""
    types = TYPES[kind]
    found = (o for o in scene.objects if o.type in types and object_props(o).kind == kind)
    return iter(sorted(found, key=lambda o: o.name))


def photo_record(item: bpy.types.Object) -> Photo | None:
    """Return the photo of a camera object, as it was imported."""
    return Photo.from_json(object_props(item).photo)


def rois(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The boxes."""
    return list(of_kind(scene, "ROI"))


def active_roi(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active box of the panel's list; the first one by default."""
    scene = scene_of(context)
    boxes, active = rois(scene), scene_props(scene).active_roi
    return active if active in boxes else next(iter(boxes), None)


def cameras(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """Photo name -> camera object: the first by name, before its copies."""
    found: dict[str, bpy.types.Object] = {}
    for camera in of_kind(scene, "CAMERA"):
        photo = photo_record(camera)
        if photo is not None:
            found.setdefault(photo.name, camera)
    return found


def camera_at_hand(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active object if it is a photo's camera, else the scene's camera if it is one."""
    items = context.active_object, scene_of(context).camera
    return next((i for i in items if i is not None and is_photo_camera(i)), None)


def is_photo_camera(item: bpy.types.Object) -> bool:
    """Whether an object is the camera of a photo."""
    return bool(object_props(item).kind == "CAMERA")


def is_suggested(item: bpy.types.Object) -> bool:
    """Whether an object is the camera of a suggested photo."""
    return bool(object_props(item).kind == "SHOT")


def named_cameras(scene: bpy.types.Scene, photos: set[str]) -> list[bpy.types.Object]:
    """Return the camera objects of some photos, fast if they are still named after their photos.

    Cameras have other names if the photo's name is long, the scene was copied, or they were
    renamed.
    """
    objects = scene.objects
    found = [objects[n] for n in photos if n in objects and _shows(objects[n], n)]
    if len(found) == len(photos):
        return found
    every = cameras(scene)
    return [every[name] for name in photos if name in every]


def _shows(item: bpy.types.Object, name: str) -> bool:
    """Whether an object is the camera of the photo with this name."""
    photo = photo_record(item) if is_photo_camera(item) else None
    return photo is not None and photo.name == name


def points(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The sparse points."""
    return next(of_kind(scene, "POINTS"), None)


def splats(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The trained Gaussians."""
    return list(of_kind(scene, "SPLATS"))


def matrix_world(item: bpy.types.Object | None) -> Matrix:
    """Return an object's transform, hidden or not; the identity if there is no object.

    Blender does not update the `matrix_world` of objects that are hidden in viewports.
    """
    if item is None:
        return np.eye(4)
    if item.is_evaluated or item.visible_get():
        return np.array(item.matrix_world, dtype=np.float64)
    return _unseen(item, matrix_world)


def corners(item: bpy.types.Object) -> Matrix:
    """(8, 3) corners of an object's bounding box in the world."""
    world = matrix_world(item)
    return np.asarray(np.array(item.bound_box) @ world[:3, :3].T + world[:3, 3])


def sides(item: bpy.types.Object) -> Matrix:
    """(3,) sides of an object's bounding box in the world; `dimensions`, hidden or not."""
    own = np.ptp(np.array(item.bound_box), axis=0)
    return np.asarray(own * np.linalg.norm(matrix_world(item)[:3, :3], axis=0))


def stands(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Matrix:
    """Return the transform of an object in a depsgraph.

    In a viewport's depsgraph, Blender does not move hidden objects, but a render may show them.

    Raises:
        AddonError: the object is too far away, or its matrix has NaN.
    """
    if depsgraph.mode == "RENDER" or item.visible_get(view_layer=depsgraph.view_layer):
        matrix = matrix_world(item.evaluated_get(depsgraph))
    else:
        matrix = _unseen(item, lambda parent: stands(parent, depsgraph))
    if not (np.abs(matrix) < FAR).all():  # catches NaN too
        raise AddonError(f"'{item.name}' is too far away or too large. Clear its transformation.")
    return matrix


def _unseen(item: bpy.types.Object, place_of: Callable[[bpy.types.Object], Matrix]) -> Matrix:
    """Return the transform of a hidden object from its own basis and its parent's place."""
    if item.constraints or (item.parent is not None and item.parent_type != "OBJECT"):
        return np.array(item.matrix_world, dtype=np.float64)
    basis: Matrix = np.array(item.matrix_basis, dtype=np.float64)
    if item.parent is None:
        return basis
    return np.asarray(place_of(item.parent) @ np.array(item.matrix_parent_inverse, float) @ basis)


def inverse(matrix: Matrix, name: str) -> Matrix:
    """Return the inverse of an object's matrix.

    Raises:
        AddonError: the matrix has no finite inverse, as in a damaged .blend.
    """
    with suppress(np.linalg.LinAlgError):
        found: Matrix = np.linalg.inv(matrix)
        if np.isfinite(found).all():
            return found
    raise AddonError(f"'{name}' has no valid position or size. Clear its transformation.")


def from_world(scene: bpy.types.Scene) -> Matrix:
    """(4, 4) from the world to the COLMAP frame; AddonError: the root has no valid place."""
    root = scene_props(scene).root
    return inverse(matrix_world(root), root.name if root is not None else "COLMAP")


def root_scale(scene: bpy.types.Scene) -> float:
    """Return the scale from the COLMAP frame to the world."""
    return transforms.scale_of(matrix_world(scene_props(scene).root)) or 1.0


def _with_root(item: bpy.types.Object, root: bpy.types.Object | None) -> tuple[Matrix, Matrix]:
    """Return the matrices of an object and of the root in a common frame.

    For a child of the root, this is the root's own frame: there, the numbers stay exactly the same
    when the root is moved. Those of `matrix_world` do not.
    """
    child = root is not None and item.parent == root and item.parent_type == "OBJECT"
    if child and not item.constraints:
        local = np.array(item.matrix_parent_inverse, float) @ np.array(item.matrix_basis, float)
        return local, np.eye(4)
    return matrix_world(item), matrix_world(root)


def box(roi: bpy.types.Object, scene: bpy.types.Scene) -> Box:
    """A box object in the COLMAP frame.

    Raises:
        AddonError: it is not a box.
    """
    root = scene_props(scene).root
    try:
        return box_from_matrix(*_with_root(roi, root), roi.empty_display_size)
    except ShearedBoxError as error:
        raise AddonError(
            f"'{roi.name}' is slanted: {error}."
            " Scale the COLMAP empty evenly, or clear the box's rotation."
        ) from error
    except (ValueError, np.linalg.LinAlgError) as error:
        raise AddonError(
            f"'{roi.name}' has no volume. Give it a size on all three axes."
        ) from error
