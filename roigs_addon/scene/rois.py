"""Boxes (ROIs, regions of interest) as cube empties: created, placed, written for the engine."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from .. import blender
from ..blender import mesh_of
from ..engine.own_files import ROIS
from ..errors import AddonError
from ..geometry.box import Box
from ..properties import object_props, scene_props
from ..shared import EngineError, files, foreground
from ..shared import names as name_format
from ..shared import rois as roi_format
from . import clouds, lookup

Place = tuple[Vector, Vector]
"""Centre and half sides of a box."""

COLOUR = (1.0, 0.55, 0.1, 1.0)
EVEN = 1e-4  # scales that differ relatively by less count as equal


def new_roi(
    scene: bpy.types.Scene, centre: Vector, half_sides: Vector, *, for_script: bool = False
) -> bpy.types.Object:
    """Create a box that is upright in the world: its rotation is zero there.

    Below an unevenly scaled root, it has the root's axes and encloses the upright box. Otherwise it
    would be slanted in the COLMAP frame.

    Args:
        scene: to add it to.
        centre, half_sides: in the world.
        for_script: keep the sides in `scale`, where a script may set others.
    """
    _remove_deleted()
    root = Matrix(lookup.matrix_world(scene_props(scene).root).tolist())
    item = _new_empty(scene, _free_name(scene))
    matrix = Matrix.LocRotScale(centre, None, half_sides)
    if _even(root):
        item.matrix_parent_inverse = root.inverted_safe()
        item.matrix_basis = matrix
    else:
        matrix = _along(root, centre, half_sides)
        item.matrix_local = root.inverted_safe() @ matrix
    if not for_script:
        _scale_evenly(item)
    return item


def add_boxes(scene: bpy.types.Scene, boxes: dict[str, Box]) -> list[bpy.types.Object]:
    """Create boxes in the COLMAP frame, below the root, wherever the root is.

    Raises:
        AddonError: one of the names is taken; then none is added.
    """
    _remove_deleted()
    _check_names(list(boxes))
    added = []
    for name, box in boxes.items():
        placed = np.linalg.inv(box.world_to_box)
        placed[:3, :3] *= box.half_extents
        item = _new_empty(scene, name)
        item.matrix_local = Matrix(placed.tolist())
        _scale_evenly(item)
        added.append(item)
    blender.view_layer_of(bpy.context).update()  # until then, `matrix_world` is the identity
    return added


def _remove_deleted() -> None:
    """Remove boxes that the user deleted. `active_roi` may keep one in the file, with its name."""
    boxes = (o for o in bpy.data.objects if object_props(o).kind == "ROI" and not o.library)
    bpy.data.batch_remove([box for box in boxes if not box.users_collection])


def _check_names(names: list[str]) -> None:
    """Raise AddonError if Blender would change a name: it numbers taken and shortens long ones."""
    items = [bpy.data.objects.new(name, None) for name in names]
    given = [item.name for item in items]
    bpy.data.batch_remove(items)
    for name, other in zip(names, given, strict=True):
        if name != other:
            if name in bpy.data.objects:
                raise AddonError(f"The name '{name}' is taken by another object. Rename it first.")
            raise AddonError(f"The name '{name}' is taken: Blender would make it {other}.")


def _new_empty(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """A cube empty of side 2 below the root, at its origin."""
    root = scene_props(scene).root
    item = bpy.data.objects.new(name, None)
    item.empty_display_type = "CUBE"
    item.empty_display_size = 1.0
    item.show_name = True
    item.color = COLOUR
    object_props(item).kind = "ROI"
    _collection(scene).objects.link(item)
    if root is not None:
        item.parent = root
        item.matrix_parent_inverse = Matrix.Identity(4)
    scene_props(scene).active_roi = item
    return item


def _scale_evenly(item: bpy.types.Object) -> None:
    """Move a box's sides from `scale` to the property `half_sides`."""
    props = object_props(item)
    props.half_sides = props.half_sides


def _collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The root's collection, unless it is excluded from the view layer."""
    root: bpy.types.Object | None = scene_props(scene).root
    layer = blender.view_layer_of(bpy.context)
    layer.update()  # until then, a new root is not in it
    if root is not None and layer.objects.get(root.name) == root:
        return root.users_collection[0]
    return scene.collection


def _even(matrix: Matrix) -> bool:
    """Whether a matrix scales all directions alike."""
    sides = np.linalg.norm(np.array(matrix.to_3x3()), axis=0)
    return bool(np.ptp(sides) <= EVEN * sides.max() and matrix.determinant() > 0)


def _along(root: Matrix, centre: Vector, half_sides: Vector) -> Matrix:
    """Return the matrix of a box with the root's axes that encloses a world-aligned box."""
    rotation = root.to_quaternion().to_matrix()
    turned = np.abs(np.array(rotation)).T @ np.array(half_sides)
    return Matrix.LocRotScale(centre, rotation.to_quaternion(), Vector(turned.tolist()))


def _free_name(scene: bpy.types.Scene) -> str:
    taken = {o.name for o in scene.objects} | {o.name for o in bpy.data.objects}
    number = 1
    while (name := f"Box {number}") in taken:
        number += 1
    return name


def default_size(scene: bpy.types.Scene) -> float:
    """Return half the side of a box added at the cursor: a tenth of the cameras' extent."""
    centres = [lookup.matrix_world(camera)[:3, 3] for camera in lookup.of_kind(scene, "CAMERA")]
    if len(centres) < 2:
        return 1.0
    spread = np.ptp(np.array(centres), axis=0).max()
    return float(spread) * 0.1 or 1.0


def where_photos_look(scene: bpy.types.Scene) -> Place | None:
    """Return the world-aligned box around the subject of most photos, outside existing boxes.

    None if it cannot be found, as without sparse points.
    """
    cloud = lookup.points(scene)
    if cloud is None:
        return None
    points, frame = clouds.positions(cloud), lookup.matrix_world(scene_props(scene).root)
    for roi in lookup.rois(scene):
        with suppress(AddonError):
            points = points[~lookup.box(roi, scene).contains(points)]
    records = map(lookup.photo_record, lookup.cameras(scene).values())
    views = [foreground.View(pose=p.pose, **asdict(p.intrinsics)) for p in records if p]
    bounds = foreground.foreground_bounds(views, points, frame)
    return _around(np.array(bounds), margin=0.0) if bounds else None


def around_objects(items: list[bpy.types.Object]) -> Place | None:
    """Return the world-aligned box around objects; None if they are all in one point."""
    return _around(np.concatenate([lookup.corners(item) for item in items])) if items else None


def around_selected_vertices(item: bpy.types.Object) -> Place | None:
    """Return the world-aligned box around a mesh's selected vertices, such as sparse points."""
    points = selected_vertices(item)
    return _around(points) if len(points) else None


def selected_vertices(item: bpy.types.Object) -> NDArray[Any]:
    """(N, 3) selected vertices of a mesh, in the world."""
    mesh = mesh_of(item)
    chosen = np.zeros(len(mesh.vertices), bool)
    mesh.vertices.foreach_get("select", chosen)
    flat = np.empty(3 * len(chosen), np.float32)
    mesh.vertices.foreach_get("co", flat)
    points = flat.reshape(-1, 3)[chosen]
    world = lookup.matrix_world(item)
    return np.asarray(points @ world[:3, :3].T + world[:3, 3])


def _around(points: NDArray[Any], margin: float = 0.05) -> Place | None:
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    if not (half > 0).any():
        return None
    half = np.maximum(half, half.max() * 0.05)
    return Vector((low + high) / 2), Vector(half * (1 + margin))


def place_key(roi: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Return a text that changes when the box is moved against its root.

    It has two digits less than Blender's precision.

    Raises:
        AddonError: it is not a box.
    """
    box = lookup.box(roi, scene)
    numbers = [*box.world_to_box[:3].ravel(), *box.half_extents]
    return " ".join(f"{value:.5g}" for value in numbers)


def trained_names(scene: bpy.types.Scene, trained: Mapping[str, tuple[Any, Any]]) -> dict[str, str]:
    """Return name -> name in training, for boxes whose place and size are those of the training.

    The names differ if a box was renamed since.

    Args:
        scene: with the boxes.
        trained: name -> world_to_box and half_extents, from a run folder.
    """
    boxes = lookup.rois(scene)
    gone = trained.keys() - {roi.name for roi in boxes}
    found: dict[str, str] = {}
    for roi in boxes:
        with suppress(AddonError):
            place = lookup.box(roi, scene)
            names = [roi.name] if roi.name in trained else sorted(gone - set(found.values()))
            same = next((name for name in names if place.is_at(*trained[name])), None)
            if same is not None:
                found[roi.name] = same
    return found


def file_name(roi: bpy.types.Object) -> str:
    """Return the box's name, which also names its files, after a check: .blends are untrusted.

    Raises:
        AddonError: it is no valid file name.
    """
    try:
        return roi_format.check_roi_name(roi.name)
    except EngineError as error:
        raise AddonError(str(error)) from error


def has_file_name(roi: bpy.types.Object) -> bool:
    """Whether the box's name is a valid file name; for panels and views."""
    try:
        file_name(roi)
    except AddonError:
        return False
    return True


def write(folder: Path, boxes: list[bpy.types.Object], scene: bpy.types.Scene) -> Path:
    """Write `rois.json` for the engine; returns its path.

    The order of the boxes does not depend on their names: a box may be renamed.

    Raises:
        AddonError: one is not a box, its name is no valid file name, or two have the same name.
    """
    path = folder / ROIS
    taken = name_format.first_taken(roi.name for roi in boxes)
    if taken is not None:
        raise AddonError(f"Two boxes are named '{taken}' (case does not count). Rename one.")
    records = [lookup.box(roi, scene).record(file_name(roi)) for roi in boxes]
    records.sort(key=lambda box: (*box.world_to_box.ravel(), *box.half_extents))
    files.write_text(path, roi_format.rois_document(records))
    return path


def read(path: Path) -> dict[str, Box]:
    """The boxes of a `rois.json` by name.

    Raises:
        AddonError: it cannot be read, or one of its entries is not a box.
    """
    if not os.path.isfile(path):
        raise AddonError(f"There is no file {path}. Choose a rois.json.")
    try:
        return {record.name: Box.of(record) for record in roi_format.read_rois(path)}
    except EngineError as error:
        raise AddonError(str(error)) from error


def between(name: str, low: Sequence[float], high: Sequence[float]) -> Box:
    """Return the box between two corners, aligned with the COLMAP frame.

    Raises:
        AddonError: it has no volume.
    """
    try:
        return Box.of(roi_format.RoiRecord.between(name, low, high))
    except EngineError as error:
        raise AddonError(str(error)) from error
