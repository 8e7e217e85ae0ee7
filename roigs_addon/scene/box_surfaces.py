"""Shows a box's mesh as an object, instead of its Gaussians or beside them.

A recreated mesh keeps its object, with place, modifiers and material. Only its data and the picture
in its material are replaced.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix as BlenderMatrix
from mathutils import Vector

from ..blender import following, is_local, leave_edit_mode, mesh_of, persistent
from ..errors import AddonError
from ..geometry.common_map import common_map
from ..geometry.frames import Matrix
from ..geometry.glb import TexturedMesh, read_glb
from ..properties import object_props, scene_props
from ..shared import EngineError, files, text
from . import clouds, detail, edits, lookup, ownership, splats, textured_meshes, visibility
from .splat_attributes import FRAME, PLACE, imported_frame, move_to_frame, values

GAUSSIANS, MESH, BOTH = "GAUSSIANS", "MESH", "BOTH"
WAYS = (
    (GAUSSIANS, "Gaussians", "Show the Gaussians of this box"),
    (MESH, "Mesh", "Show the mesh of this box instead"),
    (BOTH, "Both", "Show Gaussians and mesh; each hides parts of the other"),
)
SIZE = "roigs_picture"
"""Custom property of our pictures: size of the file in bytes."""

FILE = "roigs_glb"
"""Custom property of a mesh: SHA-256 of its file."""

_edited: dict[int, bool] = {}
"""Cache: mesh (`session_uid`) -> whether it was edited. A changed mesh is dropped."""


def surfaces(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the mesh of each box that has one. Copies belong to the user and are left out."""
    found: dict[ownership.Box, bpy.types.Object] = {}
    for item in lookup.of_kind(scene, "SURFACE"):
        found.setdefault(ownership.box_of(scene, item), item)
    return list(found.values())


def surface_of(scene: bpy.types.Scene, roi: str) -> bpy.types.Object | None:
    """The mesh of a box of the scene's own result; None if it has none."""
    return surface_of_box(scene, ownership.own_box(scene, roi))


def surface_of_box(scene: bpy.types.Scene, box: ownership.Box) -> bpy.types.Object | None:
    """The mesh of a box; None if it has none."""
    return next((i for i in surfaces(scene) if ownership.box_of(scene, i) == box), None)


def pair_of(scene: bpy.types.Scene, box: ownership.Box) -> detail.Pair | None:
    """Return the pair of a box's Gaussian objects, not of copies; None if there is none."""
    for pair in detail.pairs(scene):
        item = pair.fine or pair.coarse
        if item is not None and ownership.box_of(scene, item) == box:
            return pair
    return None


def gaussians_of(scene: bpy.types.Scene, item: bpy.types.Object) -> bpy.types.Object | None:
    """Return the Gaussian object of a mesh's box that is not switched off; None if none."""
    pair = pair_of(scene, ownership.box_of(scene, item))
    return pair.shown if pair is not None else None


def load(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Load the meshes of a run folder's result; new ones start hidden.

    Returns a message for each mesh that was left as it is.
    """
    left = []
    for (level, roi), ply in splats.result_files(folder).items():
        path = ply.with_suffix(".glb")
        if level != "ROI" or not path.is_file():
            continue
        known = surface_of(scene, roi)
        try:
            digest, of = files.sha256(path), _read_record(path).get("result")
            if known is not None and mesh_of(known).get(FILE) == digest:
                continue
            if of and of != files.sha256(ply):
                left.append(f"The mesh of '{roi}' belongs to an earlier training: make it again")
            elif known is not None and is_edited(known):
                left.append(f"'{known.name}' was edited, and is kept: its file has another mesh")
            else:
                show(scene, roi, path, seen=False)
        except (OSError, AddonError) as error:
            left.append(str(error))
    return left


def _read_record(path: Path) -> dict[str, Any]:
    try:
        record = files.read_json(record_file(path))
    except EngineError as error:
        raise AddonError(f"{error} Make the surface again.") from error
    return record if isinstance(record, dict) else {}


def record_file(path: Path) -> Path:
    """The engine's record of a mesh, beside its file."""
    return path.with_suffix(".surface.json")


def show(scene: bpy.types.Scene, roi: str, path: Path, *, seen: bool = True) -> bpy.types.Object:
    """Show a mesh file as the mesh of a box, in the box's mesh object or in a new one.

    Args:
        scene: gets a new object.
        roi: name of the box.
        path: the mesh file.
        seen: whether it replaces the Gaussians at once; else a new object is hidden.

    Raises:
        AddonError: the file, or the record beside it, is missing or damaged.
    """
    record = _read_record(path)
    try:
        read, digest = read_glb(path), files.sha256(path)
    except (OSError, ValueError) as error:
        raise AddonError(f"{error} Make the surface again.") from error
    pair, known = pair_of(scene, ownership.own_box(scene, roi)), surface_of(scene, roi)
    way = BOTH if known is not None and way_of(scene, known) == BOTH else MESH
    if known is None:
        item = _new(scene, roi, read, pair.shown if pair is not None else None)
    else:
        leave_edit_mode([known])
        item, old = known, mesh_of(known)
        fresh = _data(old.name, read, _frame(old))
        _take_materials(fresh, old, roi, read.picture)
        for other in lookup.of_kind(scene, "SURFACE"):
            if other.data == old:
                other.data = fresh
        if not old.users:
            bpy.data.batch_remove([old])
    if pair is not None and pair.fine is not None:
        mesh_of(item)[edits.SOURCE] = mesh_of(pair.fine).get(edits.SOURCE, "")
    mesh_of(item)[FILE] = digest
    object_props(item).surface = json.dumps(record)
    if seen:
        set_way(scene, item, way)
    elif known is None:
        visibility.disable(item)
    return item


def way_of(scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    """Return which of `WAYS` the viewport shows; empty if it shows neither."""
    gaussians = gaussians_of(scene, item)
    seen = gaussians is not None and not gaussians.hide_viewport
    if item.hide_viewport:
        return GAUSSIANS if seen else ""
    return BOTH if seen else MESH


def set_way(scene: bpy.types.Scene, item: bpy.types.Object, way: str) -> None:
    """Show Gaussians, mesh or both, in viewports and renders."""
    gaussians = gaussians_of(scene, item)
    for other, seen in ((item, way != GAUSSIANS), (gaussians, way != MESH)):
        if other is not None:
            other.hide_viewport = other.hide_render = not seen
            if seen:
                visibility.open_eye(scene, other)


def alone(scene: bpy.types.Scene) -> bool:
    """Whether one mesh is shown alone, see `show_alone`."""
    return any(object_props(item).beside for item in _shown_kinds(scene))


def show_alone(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Hide all Gaussians and the other meshes, in viewports and renders, until `show_all`."""
    show_all(scene)
    set_way(scene, item, MESH)
    for other in _shown_kinds(scene):
        if other != item and not object_props(other).off:
            visibility.park(other, "beside")


def foot(item: bpy.types.Object) -> Vector:
    """Return the centre of an object's bounding box, lowered to its lowest corner, in the world."""
    corners = lookup.corners(item)
    return Vector((*corners.mean(axis=0)[:2], corners[:, 2].min()))


def shift(item: bpy.types.Object, by: Vector) -> None:
    """Move all vertices of a mesh in its own frame. This moves its origin and is not an edit."""
    mesh, known = mesh_of(item), not is_edited(item)
    mesh.transform(BlenderMatrix.Translation(by))
    mesh[FRAME] = (np.array(BlenderMatrix.Translation(by)) @ imported_frame(mesh)).ravel().tolist()
    if known:
        mesh[edits.MARK] = _state(mesh)
    _edited.pop(mesh.session_uid, None)


def show_all(scene: bpy.types.Scene) -> None:
    """Show again what `show_alone` has hidden."""
    for item in _shown_kinds(scene):
        visibility.unpark(item, "beside")


def _shown_kinds(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Gaussians and meshes that can be hidden: not those of another .blend."""
    found = (*lookup.splats(scene), *lookup.of_kind(scene, "SURFACE"))
    return [item for item in found if is_local(item)]


def is_of_other_result(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether a mesh was made from other Gaussians than the box has now."""
    pair = pair_of(scene, ownership.box_of(scene, item))
    if pair is None or pair.fine is None:
        return False
    was, now = (mesh_of(each).get(edits.SOURCE, "") for each in (item, pair.fine))
    return bool(was != now)


def edited(scene: bpy.types.Scene, rois: Sequence[str] = ()) -> list[str]:
    """Return the names of edited meshes of the scene's own result, of these boxes or of all."""
    own = (i for i in surfaces(scene) if ownership.is_own(scene, i))
    found = (i for i in own if not rois or object_props(i).roi in rois)
    return [item.name for item in found if is_edited(item)]


def is_edited(item: bpy.types.Object) -> bool:
    """Whether a mesh, or the picture of its material, was changed."""
    mesh = mesh_of(item)
    if mesh.is_editmode:
        return True  # what is done in it is not in the mesh yet
    if mesh.session_uid not in _edited:
        _edited[mesh.session_uid] = mesh.get(edits.MARK) != _state(mesh)
    return _edited[mesh.session_uid] or any(map(_is_painted, _images(mesh)))


def _is_painted(image: bpy.types.Image) -> bool:
    packed = image.packed_file
    return bool(image.is_dirty or packed is None or packed.size != image[SIZE])


def record(item: bpy.types.Object) -> dict[str, Any]:
    """Return the engine's figures of a mesh; those of a wrong type are left out.

    They are the `size` of its sides, `volume`, the share `filled`, and whether it is `watertight`.
    Lengths are in units of the COLMAP model.
    """
    try:
        found = text.parse_json(object_props(item).surface.encode())
    except ValueError:
        found = {}
    given = found if isinstance(found, dict) else {}
    size = given.get("size")
    sides = [side for side in size if _is_number(side)] if isinstance(size, list) else []
    numbers = {k: given[k] for k in ("volume", "filled") if _is_number(given.get(k))}
    return {"size": sides, "watertight": given.get("watertight") is True, **numbers}


def _is_number(value: Any) -> bool:
    kind = isinstance(value, (int, float)) and not isinstance(value, bool)
    return kind and abs(value) < lookup.FAR


def _new(
    scene: bpy.types.Scene, roi: str, read: TexturedMesh, gaussians: bpy.types.Object | None
) -> bpy.types.Object:
    """Create an object with the Gaussians' place and origin; without them, centre its origin."""
    name = splats.mesh_name(roi)
    if gaussians is None:
        frame = np.eye(4)
        frame[:3, 3] = -(read.vertices.max(axis=0) + read.vertices.min(axis=0)) / 2
    else:
        frame = edits.whole_frame(mesh_of(gaussians))
    item = bpy.data.objects.new(name, _data(name, read, frame))
    mesh_of(item).materials.append(_material(name, _picture(roi, read.picture)))
    props = object_props(item)
    props.kind, props.roi, props.level = "SURFACE", roi, "ROI"
    ownership.claim(scene, item)
    if gaussians is None:
        item.parent = scene_props(scene).root
        item.location = (-frame[:3, 3]).tolist()
    else:
        item.parent, item.parent_type = gaussians.parent, gaussians.parent_type
        item.parent_bone = gaussians.parent_bone
        item.matrix_parent_inverse = gaussians.matrix_parent_inverse
        item.rotation_mode = gaussians.rotation_mode
        item.matrix_basis = gaussians.matrix_basis
    places = gaussians.users_collection if gaussians is not None else [scene.collection]
    for collection in places:
        collection.objects.link(item)
    return item


def _data(name: str, read: TexturedMesh, frame: Matrix) -> bpy.types.Mesh:
    """A mesh in a frame of its own, with one UV map."""
    mesh = textured_meshes.new_mesh(name, read)
    clouds.set_attribute(mesh, PLACE, "FLOAT_VECTOR", read.vertices)
    move_to_frame(mesh, frame)
    mesh[edits.MARK] = _state(mesh)
    return mesh


def _frame(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the COLMAP frame to a mesh's own, including **Object ▸ Apply**."""
    frame, imported = imported_frame(mesh), values(mesh, PLACE)
    if imported is None:
        return frame
    placed = imported @ frame[:3, :3].T + frame[:3, 3]
    return common_map(placed, clouds.positions_of(mesh)) @ frame


def _state(mesh: bpy.types.Mesh) -> str:
    """Return a text that changes when vertices, faces or UV coordinates do."""
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    found = zlib.crc32(corners.data, zlib.crc32(clouds.positions_of(mesh).data))
    layer: Any = mesh.uv_layers.get("UVMap")
    if layer is not None:
        uv = np.empty(2 * len(layer.uv), np.float32)
        layer.uv.foreach_get("vector", uv)
        found = zlib.crc32(uv.data, found)
    return f"{len(mesh.vertices)}-{len(mesh.polygons)}-{found:08x}"


def _picture(roi: str, data: bytes) -> bpy.types.Image:
    """A picture that the .blend contains."""
    image = textured_meshes.packed_picture(f"{roi} Texture", data)
    image[SIZE] = len(data)
    return image


def _material(name: str, image: bpy.types.Image) -> bpy.types.Material:
    """Create a matt material with a picture, lit by the scene's lights."""
    material = textured_meshes.blank_material(name)
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    picture, matt = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBsdfPrincipled")
    output = nodes.new("ShaderNodeOutputMaterial")
    picture.image = image
    matt.inputs["Roughness"].default_value = 1.0
    matt.inputs["Specular IOR Level"].default_value = 0.0  # photos have the highlights
    link(picture.outputs["Color"], matt.inputs["Base Color"])
    link(matt.outputs[0], output.inputs["Surface"])
    for x, node in enumerate((picture, matt, output)):
        node.location.x = 300 * x
    made: bpy.types.Material = material
    return made


def _nodes(mesh: bpy.types.Mesh) -> list[Any]:
    """The nodes with a picture in a mesh's materials."""
    return [node for material in mesh.materials for node in textured_meshes.image_nodes(material)]


def _images(mesh: bpy.types.Mesh) -> list[bpy.types.Image]:
    """The engine's pictures in a mesh's materials."""
    return [node.image for node in _nodes(mesh) if node.image.get(SIZE) is not None]


def _take_materials(fresh: bpy.types.Mesh, old: bpy.types.Mesh, roi: str, data: bytes) -> None:
    """Give a mesh the materials of the one that it replaces, with its own picture."""
    image = _picture(roi, data)
    gone = set(_images(old))
    material: Any
    for material in old.materials:
        nodes = textured_meshes.image_nodes(material)
        if any(node.image in gone for node in nodes) and material.users > 1:
            material = material.copy()  # copies of the mesh keep their picture
            nodes = textured_meshes.image_nodes(material)
        for node in nodes:
            if node.image in gone:
                node.image = image
        fresh.materials.append(material)
    if not gone:
        fresh.materials.clear()
        fresh.materials.append(_material(splats.mesh_name(roi), image))
    bpy.data.batch_remove([each for each in gone if not each.users])


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """Drop changed meshes from the cache."""
    for update in graph.updates if _edited else ():
        changed = update.id if update.is_updated_geometry else None
        if isinstance(changed, bpy.types.Mesh) and changed.original is not None:
            _edited.pop(changed.original.session_uid, None)


@persistent
def _forget(*_: object) -> None:
    _edited.clear()


register, _leave = following(
    ("depsgraph_update_post", _on_change),
    ("undo_post", _forget),
    ("redo_post", _forget),
    ("load_post", _forget),
)


def unregister() -> None:
    """Stop following changes."""
    _leave()
    _forget()
