"""Builds a COLMAP model's Blender objects from the files of the engine's `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..blender import camera_of, mesh_of, view_layer_of
from ..engine import exported_model
from ..errors import AddonError
from ..geometry.frames import camera_matrix
from ..geometry.photo import Photo
from ..geometry.rounding import rounding
from ..properties import object_props, scene_props
from ..shared import gravity, text
from ..windows import frame_views
from . import (
    active_camera,
    backgrounds,
    cameras,
    clouds,
    lookup,
    placement,
    start_cube,
    suggestions,
)

ROOT_NAME = "COLMAP"
# In units of the cameras' extent.
CAMERA_SIZE, POINT_RADIUS = 0.02, 0.0015
PHOTOS_OF_IMPORT = "roigs_photos"
"""Custom property that marks the collection of an import's cameras."""

MALFORMED = (ValueError, KeyError, TypeError, OverflowError)
"""Exceptions raised for a record that the engine did not write."""

UNPOSED = "without a pose"
"""The engine's reason for a photo whose camera was not found."""

TOO_FAR = (
    "The model {}. Cameras, points and boxes are off by up to half of that: move the model to the"
    " origin before you import it (docs/reliability.md says how)."
)


def import_folder(
    scene: bpy.types.Scene, folder: Path, name: str, *, same_frame: bool = False
) -> str:
    """Import an exported model into the scene, replacing an earlier import.

    The root stays, and so do the boxes below it. If it is the same model, read from any folder,
    the root also keeps its place and size. The scene keeps its active photo.

    Args:
        scene: gets a collection with root, cameras and points.
        folder: written by `export --out`.
        name: of the collection.
        same_frame: the model is the earlier one with other cameras, so the root keeps its place.

    Returns:
        A warning about the import's precision; usually empty.

    Raises:
        AddonError: the folder does not contain an exported model.
    """
    record, points, colours = _read(folder)
    photos, extent = [Photo.from_dict(image) for image in record["images"]], _extent(record)
    before = [lookup.photo_record(item) for item in lookup.cameras(scene).values()]
    active = lookup.photo_record(scene.camera) if scene.camera else None
    _remove_earlier(scene)
    if scene_props(scene).root is None:
        start_cube.hide(scene)
    known = scene_props(scene).root
    same_frame = same_frame or _same_frame(before, photos)
    stays = same_frame and known is not None and known.name in scene.objects
    if not same_frame:
        scene_props(scene).excluded.clear()  # another model's photos may have the same names
        suggestions.remove(scene)
    root = _root(scene, name, record, same_frame=same_frame)
    root.empty_display_size = extent * 0.25
    parent = root.users_collection[0]
    collection = _photo_collection(parent, name)
    for photo in photos:
        item = _add_camera(collection, root, photo, extent)
        if scene.camera is None and active is not None and active.name == photo.name:
            scene.camera = item
            active_camera.remember(scene)  # the resolution may be the user's
            backgrounds.show(camera_of(item), photo)
            backgrounds.follow(scene)
    if len(points):
        cloud = _new_cloud(f"{name} Points", points, colours, extent)
        cloud.parent = root
        parent.objects.link(cloud)
    props = scene_props(scene)
    props.root, props.model_cache = root, str(folder)
    props.skipped = skipped_in_words(record.get("skipped") or {})
    cameras.fit_clips(scene, lookup.root_scale(scene))
    centres = np.array([camera_matrix(photo.pose)[:3, 3] for photo in photos]).reshape(-1, 3)
    if not stays:
        view_layer_of(bpy.context).update()
        world = lookup.matrix_world(root)
        alike = np.repeat(centres, 1 + len(points) // max(1, len(centres)), axis=0)
        frame_views(scene, np.concatenate([alike, points]) @ world[:3, :3].T + world[:3, 3])
    lost = rounding(np.concatenate([centres, points]))
    return TOO_FAR.format(lost) if lost else ""


def deleted_photos(scene: bpy.types.Scene) -> list[str]:
    """Names of the imported photos whose cameras the user has deleted.

    The list is empty if the cache was emptied: the imported photos are then unknown.
    """
    try:
        record = exported_model.read_record(Path(scene_props(scene).model_cache))
    except (OSError, ValueError):
        return []
    there = lookup.cameras(scene)
    names = (image["name"] for image in record["images"])
    return [name for name in names if name not in there]


def restore_cameras(scene: bpy.types.Scene, names: set[str]) -> None:
    """Recreate those of these photos' cameras that the user has deleted, as they were imported.

    Raises:
        AddonError: the root is deleted, too.
    """
    gone = names.intersection(deleted_photos(scene))
    if not gone:
        return
    root: bpy.types.Object | None = scene_props(scene).root
    if root is None or not root.users_collection:
        raise AddonError(f"The empty '{ROOT_NAME}' is deleted. Import the COLMAP model again.")
    parent = root.users_collection[0]
    try:
        record = exported_model.read_record(Path(scene_props(scene).model_cache))
        photos = [Photo.from_dict(image) for image in record["images"] if image["name"] in gone]
        extent = _extent(record)
    except (OSError, *MALFORMED) as error:
        raise AddonError(
            f"The cameras cannot be read ({error}). Import the model again."
        ) from error
    collection = _photo_collection(parent, parent.name)
    for photo in photos:
        _add_camera(collection, root, photo, extent)
    cameras.fit_clips(scene, lookup.root_scale(scene))


def _add_camera(
    collection: bpy.types.Collection, root: bpy.types.Object, photo: Photo, extent: float
) -> bpy.types.Object:
    item = cameras.new_camera(photo, extent * CAMERA_SIZE)
    item.parent = root
    collection.objects.link(item)
    return item


def _extent(record: dict[str, Any]) -> float:
    return float(record.get("extent") or 1.0)


def _root(
    scene: bpy.types.Scene, name: str, record: dict[str, Any], *, same_frame: bool
) -> bpy.types.Object:
    """Return the scene's root: create it if there is none, place it again for another model.

    Its place comes from the file beside the model; without that file, it is made upright.
    """
    root: bpy.types.Object | None = scene_props(scene).root
    fresh = root is None or root.name not in scene.objects
    if root is None or fresh:
        root = _new_root(scene, name)
    if fresh or not same_frame:
        scene_props(scene).placement = scene_props(scene).placement_key = ""
        kept = record.get("placement")
        scene_props(scene).has_floor = bool(kept)
        if kept:
            placement.place_as_kept(scene, root, np.array(kept, float).reshape(4, 4))
        else:
            poses = np.array([image["world_to_camera"] for image in record["images"]])
            level = gravity.gravity_alignment(poses.reshape(-1, 4, 4))
            root.matrix_world = Matrix(level.tolist()).to_4x4()
    return root


def skipped_in_words(skipped: dict[str, Any]) -> str:
    """Describe the skipped photos of scene.json, as '3 photos left out: missing on disk'."""
    said = []
    for reason, entry in skipped.items():
        count = int(entry["count"])
        unposed = "its camera was not found" if count == 1 else "their cameras were not found"
        why = unposed if reason == UNPOSED else reason
        said.append(f"{text.counted(count, 'photo')} left out: {why}")
    return "; ".join(said)


def _remove_earlier(scene: bpy.types.Scene) -> None:
    """Remove the cameras and points of an earlier import, and their collection.

    Cameras that the user copied or moved out of the collection stay, as the user's own.
    """
    collections = [c for c in scene.collection.children_recursive if _is_marked(c)]
    imported = {item for collection in collections for item in collection.objects}
    old = [item for item in lookup.cameras(scene).values() if item in imported]
    for item in set(lookup.of_kind(scene, "CAMERA")).difference(old):
        object_props(item).kind = "NONE"
    old += lookup.of_kind(scene, "POINTS")
    data = {item.data for item in old}
    bpy.data.batch_remove(old)
    bpy.data.batch_remove([block for block in data if block is not None and not block.users])
    bpy.data.batch_remove([c for c in collections if not c.all_objects])


def _same_frame(before: list[Photo | None], photos: list[Photo]) -> bool:
    """Whether most photos have their poses of the previous model, or there was none.

    Only then is the root's place still valid. Folders cannot decide this: projects are moved, and a
    folder may contain another reconstruction later.
    """
    poses = {photo.name: photo.pose for photo in before if photo}
    stand = [np.allclose(poses[p.name], p.pose, atol=1e-4) for p in photos if p.name in poses]
    return not poses or 2 * sum(stand) > len(stand)


def _photo_collection(parent: bpy.types.Collection, name: str) -> bpy.types.Collection:
    """The collection for the cameras; an earlier import's, if the user put something into it."""
    collection = next((child for child in parent.children if _is_marked(child)), None)
    if collection is None:
        collection = bpy.data.collections.new(f"{name} Photos")
        collection[PHOTOS_OF_IMPORT] = True
        parent.children.link(collection)
    return collection


def _is_marked(collection: bpy.types.Collection) -> bool:
    return collection.get(PHOTOS_OF_IMPORT) is not None


def _read(folder: Path) -> tuple[dict[str, Any], NDArray[np.float32], NDArray[np.uint8]]:
    try:
        record = exported_model.read_record(folder)
        points = exported_model.read_numbers(folder, "points.npy", 3)
        colours = exported_model.read_numbers(folder, "colors.npy", 3)
    except (OSError, ValueError) as error:
        raise AddonError(
            f"{folder} does not contain an exported model ({error}). Import again."
        ) from error
    return record, points.astype(np.float32), colours


def _new_root(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """An empty in a collection of its own."""
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    root = bpy.data.objects.new(ROOT_NAME, None)
    root.empty_display_type = "ARROWS"
    root.rotation_mode = "QUATERNION"
    object_props(root).kind = "ROOT"
    collection.objects.link(root)
    return root


def _new_cloud(
    name: str, points: NDArray[np.float32], colours: NDArray[np.uint8], extent: float
) -> bpy.types.Object:
    cloud = clouds.new_points(name, points)
    rgba = np.ones((len(points), 4), np.float32)
    rgba[:, :3] = clouds.to_linear(colours[:, :3].astype(np.float32) / np.float32(255))
    clouds.set_attribute(mesh_of(cloud), clouds.COLOUR, "FLOAT_COLOR", rgba)
    material = clouds.colour_material("ROI-GS Points")
    clouds.show_as_points(cloud, material, extent * POINT_RADIUS)
    object_props(cloud).kind = "POINTS"
    return cloud
