"""Makes a captured object an asset: a collection with its mesh and its Gaussians.

Both are copies without a parent. They stand on the collection's origin, which is also their own.
The .blend contains the mesh's texture, its captured light and the Gaussians' attributes. If the box
contains a plate of the object's support, it is cut off.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..blender import leave_edit_mode, mesh_of
from ..errors import AddonError
from ..geometry import little_picture, support
from ..properties import object_props
from . import box_surfaces, clouds, edits, lookup, ownership, point_edits, relight, visibility
from .image_pixels import pixels_of

MARK = "roigs_taken"
"""Custom property of the collections."""
CRUMB = 0.1
"""Pieces that end below this share of the height above a cut are removed."""
TRANSFORMS = ("location", "rotation", "scale", "delta_")
"""Beginnings of the names of properties that place an object."""
SIDE, POINTS = 256, 400_000
"""Side of the preview in pixels, and number of surface points drawn in it."""
TEXT = "Captured object: its mesh and its Gaussians. Made with ROI-GS"
EMPTY = "'{}' has no faces. Make its surface again."


def names() -> list[str]:
    """Return the names of this file's assets made here."""
    return sorted(each.name for each in bpy.data.collections if each.get(MARK) and each.asset_data)


def take(scene: bpy.types.Scene, item: bpy.types.Object) -> bpy.types.Collection:
    """Make an asset from copies of a box's mesh and Gaussians.

    Raises:
        AddonError: the mesh is empty, or an object is too far away.
    """
    if not len(mesh_of(item).polygons):
        raise AddonError(EMPTY.format(item.name))
    roi = object_props(item).roi
    gaussians = box_surfaces.gaussians_of(scene, item)
    leave_edit_mode([each for each in (item, gaussians) if each is not None])
    collection = bpy.data.collections.new(roi)
    collection[MARK] = True
    mesh = _copied(item, collection)
    top = support.top_of(_corners(mesh))
    if top is not None:
        _cut(mesh, top)
    cloud = _copied(gaussians, collection) if gaussians is not None else None
    if cloud is not None and top is not None:
        point_edits.remove(cloud, point_edits.places(cloud)[:, 2] < top)
    foot, copies = _foot(mesh), [each for each in (mesh, cloud) if each is not None]
    for copy in copies:
        _stand(copy, foot)
    ownership.disown(map(object_props, copies))
    way = box_surfaces.way_of(scene, item)
    if way == box_surfaces.GAUSSIANS and cloud is not None:
        visibility.disable(mesh)
    elif way != box_surfaces.BOTH and cloud is not None:
        visibility.disable(cloud)
    _mark_as_asset(collection, mesh)
    return collection


def _foot(item: bpy.types.Object) -> Vector:
    """Return the middle of a mesh's bottom in the world; `bound_box` still includes a cut part."""
    places = _corners(item).reshape(-1, 3)
    low, high = places.min(axis=0), places.max(axis=0)
    return Vector((*((low + high) / 2)[:2].tolist(), float(low[2])))


def _copied(item: bpy.types.Object, collection: bpy.types.Collection) -> bpy.types.Object:
    """Copy an object with its data, in its place in the world, without a parent."""
    world = Matrix(lookup.stands(item, bpy.context.evaluated_depsgraph_get()).tolist())
    copy = item.copy()
    copy.data = mesh_of(item).copy()
    copy.name = item.name
    copy.parent = None
    copy.matrix_parent_inverse = Matrix()
    copy.constraints.clear()
    copy.hide_viewport = copy.hide_render = False
    props = object_props(copy)
    props.aside.clear()
    props.property_unset("parked")
    props.property_unset("beside")
    _stop_moving(copy)
    _follow_itself(copy, item)
    collection.objects.link(copy)
    copy.matrix_basis = world
    copy.matrix_world = world  # until an update, Blender does not know it
    if relight.is_on(item):
        relight.add_slider(copy, item[relight.SLIDER])
    return copy


def _stop_moving(copy: bpy.types.Object) -> None:
    """Remove a copy's animation of its place; the animation of its look stays.

    A copied object still has the original's actions, so it gets actions of its own.
    """
    animation: Any = copy.animation_data
    if animation is None:
        return
    strips = [strip for track in animation.nla_tracks for strip in track.strips]
    for user in (animation, *strips):
        if user.action is None:
            continue
        slot = getattr(user, "action_slot", None)
        user.action = user.action.copy()
        if slot is not None:
            user.action_slot = user.action.slots[slot.identifier]
        for curves in _curves_in(user.action):
            _remove_transforms(curves)
    _remove_transforms(animation.drivers)


def _curves_in(action: Any) -> Iterator[Any]:
    """Yield the curves of each slot of an action; before Blender 4.4, actions have no slots."""
    layers = getattr(action, "layers", ())
    if not layers:
        yield getattr(action, "fcurves", ())
    for layer in layers:
        for strip in layer.strips:
            yield from (bag.fcurves for bag in strip.channelbags)


def _remove_transforms(curves: Any) -> None:
    for curve in [curve for curve in curves if curve.data_path.startswith(TRANSFORMS)]:
        curves.remove(curve)


def _follow_itself(copy: bpy.types.Object, item: bpy.types.Object) -> None:
    """Let a copy's drivers read the copy, not the original."""
    drivers: Any = copy.animation_data.drivers if copy.animation_data is not None else ()
    for curve in drivers:
        for variable in curve.driver.variables:
            for target in variable.targets:
                if target.id == item:
                    target.id = copy


def _stand(item: bpy.types.Object, foot: Vector) -> None:
    """Put an object's origin at the foot, and the foot at the world's origin."""
    world = item.matrix_world
    by = -(world.inverted() @ foot)
    box_surfaces.shift(item, by) if object_props(item).kind == "SURFACE" else edits.shift(item, by)
    world = world.copy()
    world.translation = (0.0, 0.0, 0.0)
    item.matrix_basis = world
    item.matrix_world = world


def _corners(item: bpy.types.Object) -> NDArray[np.float32]:
    """(T, 3, 3) corners of a mesh's triangles in the world."""
    mesh = mesh_of(item)
    mesh.calc_loop_triangles()
    rows = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", rows)
    matrix = np.array(item.matrix_world)
    places = clouds.positions(item) @ matrix[:3, :3].T + matrix[:3, 3]
    found: NDArray[np.float32] = places[rows.reshape(-1, 3)].astype(np.float32)
    return found


def _cut(item: bpy.types.Object, top: float) -> None:
    """Remove a mesh's vertices below a height in the world, and remains of the plate above it."""
    mesh, world = mesh_of(item), item.matrix_world
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        low: Any = [v for v in edited.verts if (world @ v.co).z < top]
        bmesh.ops.delete(edited, geom=low, context="VERTS")
        crumbs: Any = _crumbs(edited, [(world @ v.co).z for v in edited.verts], top)
        bmesh.ops.delete(edited, geom=crumbs, context="VERTS")
        edited.to_mesh(mesh)
    finally:
        edited.free()
    mesh.update()


def _crumbs(edited: bmesh.types.BMesh, heights: list[float], top: float) -> list[Any]:
    """Return the vertices of pieces that end just above a cut: waves of the removed plate."""
    vertices: Any = edited.verts
    vertices.index_update()
    end = top + CRUMB * (max(heights, default=top) - top)
    seen: set[Any] = set()
    found: list[Any] = []
    for start in vertices:
        if start in seen:
            continue
        piece, ahead = [start], [start]
        seen.add(start)
        while ahead:
            last = ahead.pop()
            around = {edge.other_vert(last) for edge in last.link_edges} - seen
            seen |= around
            piece += around
            ahead += around
        if max(heights[vertex.index] for vertex in piece) < end:
            found += piece
    return found


def _mark_as_asset(collection: bpy.types.Collection, item: bpy.types.Object) -> None:
    collection.asset_mark()
    data: Any = collection.asset_data
    data.description = TEXT
    data.tags.new("captured", skip_if_exists=True)
    preview: Any = collection.preview_ensure()
    preview.image_size = (SIDE, SIDE)
    preview.image_pixels_float.foreach_set(_preview(item)[::-1].ravel())


def _preview(item: bpy.types.Object) -> NDArray[np.float32]:
    """(SIDE, SIDE, 4) picture of an object's mesh with its texture, top row first."""
    mesh, corners = mesh_of(item), _corners(item)
    faces, weights = little_picture.points_on(corners, POINTS)
    places = (corners[faces] * weights[..., None]).sum(axis=1)
    colours = np.full((len(places), 3), 0.5, np.float32)
    image, layer = relight.image_of(mesh), mesh.uv_layers.active
    if image is not None and layer is not None and min(image.size) > 0:
        loops = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("loops", loops)
        uv = np.empty(2 * len(mesh.loops), np.float32)
        layer.uv.foreach_get("vector", uv)
        at = (uv.reshape(-1, 2)[loops.reshape(-1, 3)[faces]] * weights[..., None]).sum(axis=1)
        colours = _looked_up(image, at)
    return little_picture.picture(places, colours, SIDE)


def _looked_up(image: bpy.types.Image, at: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 3) a picture's pixels at places (N, 2) in 0 to 1, from its lower left corner."""
    pixels = pixels_of(image)
    height, width = pixels.shape[:2]
    x, y = (np.clip(at[:, k] * n, 0, n - 1).astype(int) for k, n in enumerate((width, height)))
    return pixels[y, x, :3]
