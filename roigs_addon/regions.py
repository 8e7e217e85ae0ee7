"""ROIs: cube empties, the boxes that they are in the COLMAP frame, and what is in these boxes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import lookup
from .errors import AddonError
from .frames import Box

COLOUR = (1.0, 0.55, 0.1, 1.0)
FORBIDDEN = '/\\:*?"<>|\0'  # ROI names become file names


def new_roi(scene: bpy.types.Scene, centre: Vector, half_sides: Vector) -> bpy.types.Object:
    """A box in world space, its axes along the root's so that it stays a box when the root is
    scaled unevenly."""
    _remove_deleted()
    root = scene.roigs.root
    item = _new_empty(scene, _free_name(scene))
    matrix = Matrix.LocRotScale(centre, None, half_sides)
    if root is not None:
        matrix = _along(root.matrix_world, centre, half_sides)
        item.matrix_local = root.matrix_world.inverted_safe() @ matrix
    else:
        item.matrix_world = matrix
    return item


def add_boxes(scene: bpy.types.Scene, boxes: dict[str, Box]) -> None:
    """Boxes given in the COLMAP frame, below the root, wherever the user has put that.

    Raises:
        AddonError: one of the names is taken; none is added then.
    """
    _remove_deleted()
    _check_names(list(boxes))
    for name, box in boxes.items():
        placed = np.linalg.inv(box.world_to_box)
        placed[:3, :3] *= box.half_extents
        _new_empty(scene, name).matrix_local = Matrix(placed.tolist())
    bpy.context.view_layer.update()  # until then, `matrix_world` is that of a fresh object


def _remove_deleted() -> None:
    """Boxes that the user deleted: `active_roi` keeps one in the file, and with it its name."""
    items = (item for item in bpy.data.objects if item.roigs.kind == "ROI" and not item.library)
    bpy.data.batch_remove([item for item in items if not item.users_collection])


def _check_names(names: list[str]) -> None:
    """Ask Blender, which numbers names that are taken and shortens long ones."""
    items = [bpy.data.objects.new(name, None) for name in names]
    given = [item.name for item in items]
    bpy.data.batch_remove(items)
    for name, other in zip(names, given, strict=True):
        if name != other:
            raise AddonError(
                f"The name «{name}» is taken (it would be {other}). Rename one of them."
            )


def load(path: Path) -> dict[str, Box]:
    """The boxes of a `rois.json` (docs/files.md) by name.

    Raises:
        AddonError: it cannot be read, or one of them is no box.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AddonError(f"{path} cannot be read ({error}).") from error
    records = document.get("rois") if isinstance(document, dict) else document
    if not isinstance(records, list) or not records:
        raise AddonError(f"{path} holds no ROI. It needs a list «rois», see docs/files.md.")
    boxes: dict[str, Box] = {}
    for number, record in enumerate(records, start=1):
        try:
            name, box = str(record["name"]), _from_dict(record)
        except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
            raise AddonError(f"ROI {number} of {path} is no box ({error}).") from error
        if name in boxes:
            raise AddonError(f"Two ROIs of {path} are named «{name}». Give each its own name.")
        boxes[name] = box
    return boxes


def from_corners(low: Any, high: Any) -> Box:
    """The box between two corners, along the axes of the COLMAP frame.

    Raises:
        ValueError: it has no volume.
    """
    corners = np.array([low, high], dtype=np.float64)
    half = (corners[1] - corners[0]) / 2
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (half > 0).all():
        raise ValueError("each coordinate of the second corner must be larger than the first's")
    world_to_box = np.eye(4)
    world_to_box[:3, 3] = -corners.mean(axis=0)
    return Box(world_to_box=world_to_box, half_extents=half)


def _from_dict(record: dict[str, Any]) -> Box:
    if "min" in record or "max" in record:
        return from_corners(record["min"], record["max"])
    matrix = np.array(record["world_to_box"], dtype=np.float64)
    half = np.array(record["half_extents"], dtype=np.float64)
    if matrix.shape != (4, 4) or half.shape != (3,) or not (half > 0).all():
        raise ValueError("it needs a 4 x 4 matrix and three half extents above 0")
    rotation = matrix[:3, :3]
    if not np.isfinite(matrix).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise ValueError("its matrix is no rotation and translation")
    return Box(world_to_box=matrix, half_extents=half)


def _new_empty(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """A cube empty of side 2 below the root, at its origin."""
    root = scene.roigs.root
    item = bpy.data.objects.new(name, None)
    item.empty_display_type = "CUBE"
    item.empty_display_size = 1.0
    item.show_name = True
    item.color = COLOUR
    item.roigs.kind = "ROI"
    _home(scene).objects.link(item)
    if root is not None:
        item.parent = root
        item.matrix_parent_inverse = Matrix.Identity(4)
    scene.roigs.active_roi = item
    return item


def _home(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The root's collection, unless that is excluded from the view layer."""
    root, layer = scene.roigs.root, bpy.context.view_layer
    layer.update()  # until then, it knows nothing of a fresh root
    seen = root is not None and layer.objects.get(root.name) == root
    return root.users_collection[0] if seen else scene.collection


def _along(root: Matrix, centre: Vector, half_sides: Vector) -> Matrix:
    """A box with the root's axes that holds the world-aligned box."""
    rotation = root.to_quaternion().to_matrix()
    turned = Vector(
        sum(abs(rotation[world][axis]) * half_sides[world] for world in range(3))
        for axis in range(3)
    )
    return Matrix.LocRotScale(centre, rotation.to_quaternion(), turned)


def _free_name(scene: bpy.types.Scene) -> str:
    taken = {o.name for o in scene.objects} | {o.name for o in bpy.data.objects}
    number = 1
    while (name := f"ROI {number}") in taken:
        number += 1
    return name


def default_size(scene: bpy.types.Scene) -> float:
    """Half the side of a box that is added at the cursor: a tenth of what the cameras stand on."""
    centres = [lookup.matrix_world(camera)[:3, 3] for camera in lookup.of_kind(scene, "CAMERA")]
    if len(centres) < 2:
        return 1.0
    spread = np.ptp(np.array(centres), axis=0).max()
    return float(spread) * 0.1 or 1.0


def around_objects(items: list[bpy.types.Object]) -> tuple[Vector, Vector] | None:
    """Centre and half sides of the world-aligned box around objects; None when it is flat."""
    corners = [item.matrix_world @ Vector(corner) for item in items for corner in item.bound_box]
    return _around(np.array([tuple(corner) for corner in corners])) if corners else None


def around_selected_vertices(item: bpy.types.Object) -> tuple[Vector, Vector] | None:
    """The same around the vertices that are selected in a mesh (the sparse points, say)."""
    mesh = item.data
    chosen = np.zeros(len(mesh.vertices), bool)
    mesh.vertices.foreach_get("select", chosen)
    flat = np.empty(3 * len(chosen), np.float32)
    mesh.vertices.foreach_get("co", flat)
    points = flat.reshape(-1, 3)[chosen]
    if not len(points):
        return None
    world = lookup.matrix_world(item)
    return _around(points @ world[:3, :3].T + world[:3, 3])


def _around(points: Any) -> tuple[Vector, Vector] | None:
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    if not (half > 0).any():
        return None
    half = np.maximum(half, half.max() * 0.05)
    return Vector((low + high) / 2), Vector(half * 1.05)


def to_dict(roi: bpy.types.Object, scene: bpy.types.Scene) -> dict[str, Any]:
    """A ROI as `rois.json` has it (files.md).

    Raises:
        AddonError: it is no box, or its name cannot be that of a file.
    """
    box = lookup.box(roi, scene)
    return {
        "name": file_name(roi),
        "world_to_box": box.world_to_box.tolist(),
        "half_extents": box.half_extents.tolist(),
    }


def file_name(roi: bpy.types.Object) -> str:
    """The box's name, which is also that of its files; a .blend may come from anybody.

    Raises:
        AddonError: it cannot be that.
    """
    if any(c in FORBIDDEN for c in roi.name) or not roi.name.strip(" ."):
        raise AddonError(
            f'«{roi.name}» cannot name a file. Rename the ROI without / \\ : * ? " < > |'
        )
    return roi.name


def box_key(roi: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Changes when the box does, against its root; two decimals less than Blender's precision."""
    box = lookup.box(roi, scene)
    numbers = [*box.world_to_box[:3].ravel(), *box.half_extents]
    return " ".join(f"{value:.5g}" for value in numbers)


def write(folder: Path, rois: list[bpy.types.Object], scene: bpy.types.Scene) -> Path:
    """Write `rois.json` for the engine; returns its path."""
    path = folder / "rois.json"
    records = [to_dict(roi, scene) for roi in rois]
    path.write_text(json.dumps({"rois": records}, indent=1, ensure_ascii=False), encoding="utf-8")
    return path
