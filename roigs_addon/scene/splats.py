"""Trained and imported Gaussians as Blender objects, for every render engine and the viewport.

Each object is a mesh of points with the attributes of docs/conventions.md. A modifier makes
Blender's own splats of them or hides them (display.py). In the second case the add-on draws the
Gaussians in the viewport (viewport/), and the engine draws them in renders (compositor.py). Points
can be deleted, hidden and moved in edit mode (edits.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import bpy
import numpy as np

from ..blender import delete, is_local, leave_edit_mode, mesh_of
from ..engine.earlier_results import earlier_results
from ..errors import AddonError
from ..geometry.splat_cloud import read_splats
from ..properties import object_props, scene_props
from ..shared import run_files
from . import (
    clouds,
    compositor,
    detail,
    display,
    edits,
    lookup,
    origins,
    ownership,
    start_cube,
    visibility,
)
from .renamed_boxes import renamed
from .splat_attributes import add_attributes

Part = tuple[str, str]
"""Part of a result: the level of `properties.LEVELS`, and the box."""

BELOW = {"RESULT": 1, "SCENE": 2, "ROI": 2, "IMPORTED": 3}
"""Level -> number of parts in the path of its file, relative to the run folder."""

MESH_FILE = ".surface.ply"
"""End of names of mesh files beside the boxes' files; `surface --format ply` writes them."""
COLLECTION = "ROI-GS Gaussians"
GAUSSIANS = "roigs_gaussians"
"""Custom property that marks the collection; another scene's has the name."""
UNUSED = "ROI-GS new"
MATERIAL = "ROI-GS Gaussians"


def show_results(scene: bpy.types.Scene, folder: Path) -> list[bpy.types.Object]:
    """Import a run's Gaussians: the background, and each box's result and first pass.

    Objects of an earlier result and their copies get the new data. Objects of a box that this
    result does not have are removed: its background contains what they showed. Objects that were
    appended, linked or taken are left alone.

    Raises:
        AddonError: a file is missing or damaged.
    """
    leave_edit_mode(ownership.own_splats(scene))
    remove_preview(scene)
    _hide_sparse(scene)
    files = result_files(folder)
    take_names(scene, files)
    fresh = read_files(files)
    rename_boxes(scene, renamed(scene, fresh))
    shown = [item for part, file in files.items() for item in show(scene, part, file, fresh[part])]
    for item in ownership.own_splats(scene):
        props = object_props(item)
        file = files.get((props.level, props.roi))
        if file is not None:
            edits.drop_aside(item)
        elif props.level in ("ROI", "SCENE"):
            delete(item)
    compositor.link(scene)
    return shown


def show_imported(
    scene: bpy.types.Scene, path: Path, name: str, *, in_model: bool
) -> bpy.types.Object:
    """Create an object from a file that no training of this scene made.

    Args:
        scene: gets the object.
        path: the file.
        name: of the object.
        in_model: the file is in the COLMAP frame; else in Blender's world.

    Raises:
        AddonError: the file is missing or damaged.
    """
    fresh = read_files({("IMPORTED", ""): path})["IMPORTED", ""]
    if scene_props(scene).root is None:
        start_cube.hide(scene)
    origins.centre_on_points(fresh)
    item = _new_object(scene, name, fresh)
    if not in_model:
        item.parent = None
    props = object_props(item)
    props.level, props.ply = "IMPORTED", str(path)
    compositor.link(scene)
    return item


def result_files(folder: Path) -> dict[Part, Path]:
    """The files of a result: of the background, of each box, and of its first pass."""
    files: dict[Part, Path] = {("RESULT", ""): folder / run_files.BACKGROUND}
    for path in sorted((folder / run_files.FINE).glob("*.ply")):
        if path.name.endswith(MESH_FILE):
            continue
        files["ROI", path.stem] = path
        coarse = folder / run_files.COARSE / path.name
        if coarse.is_file():
            files["SCENE", path.stem] = coarse
    return files


def rename_boxes(scene: bpy.types.Scene, renamed: Mapping[str, str]) -> None:
    """Give the Gaussians of renamed boxes, old name -> new one, the new names."""
    for item in ownership.own_objects(scene):
        props = object_props(item)
        if new := renamed.get(props.roi):
            if item.name in (mesh_name(props.roi), object_name(props.level, props.roi)):
                own = props.kind == "SURFACE"
                item.name = mesh_name(new) if own else object_name(props.level, new)
            props.roi = new


def take_names(scene: bpy.types.Scene, files: Mapping[Part, Path]) -> None:
    """Give Gaussians from these files the names of the files' boxes.

    A training that failed at once has not renamed the files of renamed boxes.
    """
    of_file = {str(file): roi for (_, roi), file in files.items()}
    shown = (object_props(item) for item in ownership.own_splats(scene))
    pairs = {(props.roi, of_file[props.ply]) for props in shown if props.ply in of_file}
    rename_boxes(scene, {now: roi for now, roi in pairs if now != roi})


def show_preview(scene: bpy.types.Scene, path: Path) -> bpy.types.Object:
    """Show the model in training. Meanwhile, the scene's own result is hidden."""
    item = next(iter(_of(scene, "PREVIEW", "")), None)
    if item is None:
        item = _new_object(
            scene, "ROI-GS Preview", clouds.new_points("Preview", np.zeros((0, 3), np.float32))
        )
        object_props(item).level = "PREVIEW"
        ownership.claim(scene, item)
        display.show_as(item, "EXACT")  # it has only its file, no points
        for other in ownership.own_objects(scene):
            if other != item:
                visibility.wait(other)
        _hide_sparse(scene)
    object_props(item).ply = str(path)
    return item


def follow(scene: bpy.types.Scene, folder: Path) -> int:
    """Find missing files of Gaussians in a moved run folder, or among earlier results.

    A new training moves the last result there. Returns the number of objects whose file was found.
    """
    shown = [i for i in lookup.splats(scene) if object_props(i).ply and is_local(i)]
    lost = [item for item in shown if not edits.is_held(item, object_props(item).ply)]
    results = [folder, *(result.folder for result in earlier_results(folder))] if lost else []
    found = 0
    for item in lost:
        props = object_props(item)
        own = PureWindowsPath(props.ply)  # splits paths of any system
        part = own.parts[-BELOW.get(props.level, len(own.parts)) :]
        places = [result.joinpath(*part) for result in results]
        if (box := result_files(folder).get((props.level, props.roi))) is not None:
            places.append(box)  # it was renamed
        now = next((str(place) for place in places if edits.is_held(item, str(place))), None)
        if now is not None:
            props.ply = now
            found += 1
    return found


def show_as(scene: bpy.types.Scene, way: str) -> None:
    """Show all Gaussians in one of the ways of `properties.SHOWN_AS`; a preview stays as it is."""
    for item in lookup.splats(scene):
        if object_props(item).level != "PREVIEW":
            display.show_as(item, way)
    compositor.link(scene)


def remove_preview(scene: bpy.types.Scene) -> None:
    """Remove the preview of the training; show again the objects hidden for it, boxes refined."""
    for item in ownership.own_objects(scene):
        visibility.resume(item)
        visibility.unpark(item)
        if object_props(item).level == "PREVIEW":
            delete(item)
    detail.reset(scene)


def _hide_sparse(scene: bpy.types.Scene) -> None:
    """Hide the sparse points: as solid objects they would cover Gaussians behind them."""
    sparse = lookup.points(scene)
    if sparse is not None and is_local(sparse):
        visibility.disable(sparse)


def _of(scene: bpy.types.Scene, level: str, roi: str) -> list[bpy.types.Object]:
    """Return the object of a part, and its copies.

    Edited copies and separated parts are left out: they are objects of their own.
    """
    kinds = ((item, object_props(item)) for item in ownership.own_splats(scene))
    found = [item for item, props in kinds if props.level == level and props.roi == roi]
    first = found[0].data if found else None
    return [item for item in found if item.data == first or not edits.is_edited(item)]


def object_name(level: str, roi: str) -> str:
    """Return the initial name of an object of Gaussians."""
    return {"SCENE": f"{roi} first pass", "ROI": f"{roi} Gaussians"}.get(level, "Background")


def mesh_name(roi: str) -> str:
    """Return the initial name of the mesh of a box's surface."""
    return f"{roi} Mesh"


def read_files(files: Mapping[Part, Path]) -> dict[Part, bpy.types.Object]:
    """Create objects from files, all or none, so that parts of two results are never mixed.

    Raises:
        AddonError: a file is missing or damaged.
    """
    made: dict[Part, bpy.types.Object] = {}
    try:
        for part, path in files.items():
            made[part] = _points(object_name(*part), path)
            made[part].name = UNUSED  # an object that is renamed may need its name
    except AddonError:
        for item in made.values():
            delete(item)
        raise
    return made


def show(
    scene: bpy.types.Scene, part: Part, path: Path, fresh: bpy.types.Object
) -> list[bpy.types.Object]:
    """Show a file as this part of the result, in the part's existing objects or in `fresh`.

    Args:
        scene: with the objects.
        part: of the result.
        path: the file.
        fresh: a new object made from the file.
    """
    (level, roi), name = part, object_name(*part)
    shown = _of(scene, level, roi)
    if shown:  # they keep their names, places and the user's other changes
        _give_data(shown, fresh)
    else:
        origins.centre_on_box(scene, fresh, roi)
        shown = [_new_object(scene, name, fresh)]
        if level == detail.COARSE:
            detail.switch_off(fresh)
    for item in shown:
        props = object_props(item)
        props.level, props.roi, props.ply = level, roi, str(path)
        ownership.claim(scene, item)
    return shown


def _give_data(items: list[bpy.types.Object], source: bpy.types.Object) -> None:
    """Give objects the data of `source`, which is removed; objects with common data keep sharing.

    The new data gets the frame of the old: its origin, and changes by Object > Apply.
    """
    given: dict[Any, Any] = {}
    fresh: Any = source.data
    for item in items:
        if item.data not in given:
            given[item.data] = fresh.copy()
            if isinstance(item.data, bpy.types.Mesh):
                edits.place(given[item.data], edits.whole_frame(item.data))
    for item in items:
        item.data = given[item.data]
    bpy.data.objects.remove(source)
    bpy.data.batch_remove([old for old in (*given, fresh) if old is not None and not old.users])


def _points(name: str, path: Path) -> bpy.types.Object:
    """Read a file into a mesh of points with all of the Gaussians' attributes."""
    try:
        cloud = read_splats(path)
    except (OSError, ValueError) as error:
        raise AddonError(f"{error} Train or import again.") from error
    item = clouds.new_points(name, cloud.means)
    add_attributes(mesh_of(item), cloud)
    edits.mark_imported(mesh_of(item), path)
    return item


def _collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return the scene's collection of Gaussians; it may be moved and renamed."""
    known = (c for c in scene.collection.children_recursive if is_local(c))
    # Earlier versions did not mark it.
    collection = next((c for c in known if c.get(GAUSSIANS) or c.name == COLLECTION), None)
    if collection is None:
        collection = bpy.data.collections.new(COLLECTION)
        collection[GAUSSIANS] = True
        scene.collection.children.link(collection)
    return collection


def _material() -> bpy.types.Material:
    """Return this .blend's material of points, not a linked one."""
    known = (each for each in bpy.data.materials if each.name == MATERIAL and is_local(each))
    return next(known, None) or clouds.colour_material(MATERIAL, "opacity")


def _new_object(scene: bpy.types.Scene, name: str, item: bpy.types.Object) -> bpy.types.Object:
    others = (object_props(other) for other in lookup.splats(scene))
    like = next((props for props in others if props.level != "PREVIEW"), object_props(item))
    way, exact_for = like.shown_as, like.exact_for
    item.name = name
    object_props(item).kind = "SPLATS"
    item.parent = scene_props(scene).root
    _collection(scene).objects.link(item)
    clouds.show_as_points(item, _material(), "radius")
    clouds.add_nodes_modifier(item, display.MODIFIER, None)
    display.show_as(item, way)
    object_props(item).exact_for = exact_for
    return item
