"""A COLMAP model as Blender objects, from the files that the engine's `export` wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Quaternion, Vector
from numpy.typing import NDArray

from . import cameras, clouds, counts, lookup
from .errors import AddonError
from .photo import Photo

ROOT_NAME = "COLMAP"
# Shares of the cameras' extent.
CAMERA_SIZE, POINT_RADIUS = 0.02, 0.0015
SHELF = "roigs_photos"
"""Custom property of the collection that holds an import's cameras."""


def import_folder(scene: bpy.types.Scene, folder: Path, name: str) -> dict[str, int]:
    """Bring an exported model into the scene, in place of one that was imported before.

    The root stays, and with it the boxes that hang on it; a model that is read again, from
    wherever, keeps the root's place and size too, and the photo that the scene looks through.

    Args:
        scene: gets a collection with root, cameras and points.
        folder: what `export --out` wrote.
        name: of the collection.

    Returns:
        What was imported, and how much of it.

    Raises:
        AddonError: the folder does not hold an exported model.
    """
    record, points, colours = _read(folder)
    photos = [Photo.from_dict(image) for image in record["images"]]
    extent = float(record.get("extent") or 1.0)
    before = [Photo.from_json(item.roigs.photo) for item in lookup.cameras(scene).values()]
    active = Photo.from_json(scene.camera.roigs.photo) if scene.camera else None
    _remove_earlier(scene)
    root = scene.roigs.root
    fresh = root is None or root.name not in scene.objects
    if fresh:
        root = _new_root(scene, name)
    root.empty_display_size = extent * 0.25
    if fresh or not _same_frame(before, photos):
        root.matrix_world = upright(photos).to_matrix().to_4x4()
    home = root.users_collection[0]
    shelf = _shelf(home, name)
    for photo in photos:
        item = cameras.new_camera(photo, extent * CAMERA_SIZE)
        item.parent = root
        shelf.objects.link(item)
        if scene.camera is None and active is not None and active.name == photo.name:
            scene.camera = item
            cameras.show_background(item.data, photo)
    if len(points):
        cloud = _new_cloud(f"{name} Points", points, colours, extent)
        cloud.parent = root
        home.objects.link(cloud)
    scene.roigs.root, scene.roigs.model_cache = root, str(folder)
    scene.roigs.skipped = skipped_in_words(record.get("skipped") or {})
    counts.forget()
    return {"photos": len(photos), "points": len(points)}


def skipped_in_words(skipped: dict[str, Any]) -> str:
    """«3 missing on disk, 1 without a pose», or nothing; from scene.json (docs/files.md)."""
    return ", ".join(f"{entry['count']} {reason}" for reason, entry in skipped.items())


def _remove_earlier(scene: bpy.types.Scene) -> None:
    """Take the cameras and points of an earlier import out, with their collection.

    Cameras that the user copied or took out of the collection stay, as any other camera of theirs.
    """
    shelves = [shelf for shelf in scene.collection.children_recursive if SHELF in shelf]
    shelved = {item for shelf in shelves for item in shelf.objects}
    old = [item for item in lookup.cameras(scene).values() if item in shelved]
    for item in set(lookup.of_kind(scene, "CAMERA")).difference(old):
        item.roigs.kind = "NONE"
    old += lookup.of_kind(scene, "POINTS")
    data = {item.data for item in old}
    bpy.data.batch_remove(old)
    bpy.data.batch_remove([block for block in data if not block.users])
    bpy.data.batch_remove([shelf for shelf in shelves if not shelf.all_objects])


def _same_frame(before: list[Photo | None], photos: list[Photo]) -> bool:
    """Whether photos stand where they stood in the model of before, as far as there was one.

    Only then has the place that the user gave the root a meaning for the new one. Folders do not
    tell: projects are moved, and one folder may hold another reconstruction later.
    """
    poses = {photo.name: photo.pose for photo in before if photo}
    stand = [np.allclose(poses[p.name], p.pose, atol=1e-4) for p in photos if p.name in poses]
    return not poses or 2 * sum(stand) > len(stand)


def _shelf(home: bpy.types.Collection, name: str) -> bpy.types.Collection:
    """The collection for the cameras; that of an earlier import when the user has some in it."""
    shelf = next((child for child in home.children if SHELF in child), None)
    if shelf is None:
        shelf = bpy.data.collections.new(f"{name} Photos")
        shelf[SHELF] = True
        home.children.link(shelf)
    return shelf


def _read(folder: Path) -> tuple[dict[str, Any], NDArray[np.float32], NDArray[np.uint8]]:
    try:
        record = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        points = np.load(folder / "points.npy", allow_pickle=False)
        colours = np.load(folder / "colors.npy", allow_pickle=False)
        record["images"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise AddonError(f"{folder} holds no exported model ({error}). Import again.") from error
    return record, points.astype(np.float32), colours


def _new_root(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """An empty in a collection of its own."""
    home = bpy.data.collections.new(name)
    scene.collection.children.link(home)
    root = bpy.data.objects.new(ROOT_NAME, None)
    root.empty_display_type = "ARROWS"
    root.rotation_mode = "QUATERNION"
    root.roigs.kind = "ROOT"
    home.objects.link(root)
    return root


def upright(photos: list[Photo]) -> Quaternion:
    """Turns the COLMAP frame, whose axes mean nothing, so that the photographer stands upright."""
    up = -np.sum([photo.pose[1, :3] for photo in photos], axis=0) if photos else np.zeros(3)
    if np.linalg.norm(up) < 1e-6 * max(len(photos), 1):
        return Quaternion()
    return Vector(up).rotation_difference(Vector((0, 0, 1)))


def _new_cloud(
    name: str, points: NDArray[np.float32], colours: NDArray[np.uint8], extent: float
) -> bpy.types.Object:
    cloud = clouds.new_points(name, points)
    rgba = np.ones((len(points), 4), np.float32)
    rgba[:, :3] = clouds.to_linear(colours[:, :3].astype(np.float32) / 255)
    clouds.set_attribute(cloud.data, clouds.COLOUR, "FLOAT_COLOR", rgba)
    material = clouds.colour_material("ROI-GS Points")
    clouds.show_as_points(cloud, material, extent * POINT_RADIUS)
    cloud.roigs.kind = "POINTS"
    return cloud
