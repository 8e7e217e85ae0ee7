"""Finds where an object stands on a captured surface, and puts it there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from ..blender import mesh_of
from ..errors import AddonError
from ..geometry import placing
from ..properties import object_props
from ..shared import gravity
from . import box_surfaces, clouds, lookup, proxies, surfaces

LEVEL = 5.0
"""Degrees: a surface that is as level as that is level; what is measured of one errs by 1 to 3."""
FEWEST = 30
"""Gaussians that tell how a surface lies."""
GRAZING = 0.17
"""Sine of 10 degrees, between a plane and the direction in which it is looked at."""
RING = 12
"""Places around a point at which a mesh is felt."""
NEAR = 0.2
"""Of its distance from the eye: a mesh so near to the Gaussians that were clicked is the same
surface."""
UP = (0.0, 0.0, 1.0)

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Spot:
    """A place on a captured surface.

    Attributes:
        point: in the world.
        normal: of length 1, on the viewed side.
        on_mesh: whether it is on a mesh, which catches shadows there.
    """

    point: Vector
    normal: Vector
    on_mesh: bool


def find(
    scene: bpy.types.Scene, eye: Vector, point: Vector, radius: float, found: Sequence[Points]
) -> Spot:
    """Return the place on a captured surface that was clicked.

    Args:
        scene: of the surface.
        eye: the viewpoint.
        point: the clicked Gaussian, or place on a mesh.
        radius: of the object that will stand there.
        found: (N, 3) positions of the Gaussians in the world.

    Raises:
        AddonError: there is no surface.
    """
    trees = list(_trees(scene))
    along = (point - eye).normalized()
    hit = _felt(trees, eye, along)
    if hit is not None and (hit[0] - point).length < NEAR * (point - eye).length + radius:
        return _on_mesh(trees, hit, along, radius)
    return _on_gaussians(eye, point, radius, found)


def _trees(scene: bpy.types.Scene) -> Iterator[BVHTree]:
    """Yield the meshes of captured surfaces in the world, shown or not."""
    items = [i for i in proxies.of_scene(scene) if object_props(i).level != "IMPORTED"]
    known = {object_props(item).roi for item in items}
    items += [i for i in box_surfaces.surfaces(scene) if object_props(i).roi not in known]
    for item in items:
        mesh = mesh_of(item)
        mesh.calc_loop_triangles()
        rows = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", rows.reshape(-1))
        world = lookup.matrix_world(item)
        places = clouds.positions_of(mesh) @ world[:3, :3].T + world[:3, 3]
        tree: Any = BVHTree.FromPolygons(places.tolist(), rows.tolist(), all_triangles=True)
        yield tree


def _felt(trees: Sequence[BVHTree], eye: Vector, along: Vector) -> tuple[Vector, Vector] | None:
    """Return the first place on a mesh in a direction, and its normal; None if there is none."""
    there: list[Any] = [tree.ray_cast(eye, along) for tree in trees]
    hits = [(away, place, normal) for place, normal, _, away in there if place is not None]
    return min(hits, key=lambda hit: float(hit[0]))[1:] if hits else None


def _on_mesh(
    trees: Sequence[BVHTree], hit: tuple[Vector, Vector], along: Vector, radius: float
) -> Spot:
    """Return the plane through probed places around a hit; the mesh's own plane if few."""
    point, normal = hit[0], _towards(hit[1], along)
    side = normal.orthogonal().normalized()
    felt = [point]
    for number in range(2 * RING):
        turn = Matrix.Rotation(2 * np.pi * number / RING, 3, normal)
        start = point + radius * (0.5 if number < RING else 1.0) * (turn @ side)
        near = _felt(trees, start + radius * normal, -normal)
        if near is not None and abs((near[0] - point) @ normal) < radius:
            felt.append(near[0])
    plane = placing.plane_through(np.array(felt, float))
    if plane is not None and len(felt) > RING:
        normal = _towards(Vector(plane.normal.tolist()), along)
        point = _seen_on(point, along, Vector(plane.point.tolist()), normal)
    return Spot(point=point, normal=_levelled(normal), on_mesh=True)


def _on_gaussians(eye: Vector, point: Vector, radius: float, found: Sequence[Points]) -> Spot:
    """Return the plane through the Gaussians around a point."""
    points = np.concatenate([np.empty((0, 3)), *found])
    away = np.linalg.norm(points - np.array(point), axis=1)
    if len(points) < FEWEST:
        raise AddonError("There is no captured surface. Click on Gaussians, or on their mesh.")
    reach = max(radius, float(np.partition(away, FEWEST - 1)[FEWEST - 1]))
    plane = placing.plane_through(points[away <= reach])
    if plane is None:
        raise AddonError("These Gaussians form no surface. Click on a larger one.")
    along = (point - eye).normalized()
    normal = _levelled(_towards(Vector(plane.normal.tolist()), along))
    place = _seen_on(point, along, Vector(plane.point.tolist()), normal)
    return Spot(point=place, normal=normal, on_mesh=False)


def _seen_on(point: Vector, along: Vector, middle: Vector, normal: Vector) -> Vector:
    """Return where the ray to a point meets the plane through `middle`.

    At a grazing angle, small errors of the plane would move it far. There, it is the point's
    projection onto the plane.
    """
    away, slope = (middle - point) @ normal, along @ normal
    return point + (away / slope * along if abs(slope) > GRAZING else away * normal)


def _towards(normal: Vector, along: Vector) -> Vector:
    """Return the unit normal that points against a viewing direction."""
    return (-normal if normal @ along > 0 else normal).normalized()


def _levelled(normal: Vector) -> Vector:
    """Return straight up if a normal is nearly so, else the normal."""
    up = Vector(UP)
    return up if normal.angle(up) < np.radians(LEVEL) else normal


def radius_of(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> float:
    """Return half the largest side of an object with its children, in the world."""
    points = _points(item, depsgraph)
    return float(np.ptp(points, axis=0).max()) / 2 if len(points) else 0.0


def put(item: bpy.types.Object, spot: Spot, depsgraph: bpy.types.Depsgraph) -> Vector:
    """Put an object on a spot: turned to its normal, with its lowest point on the surface.

    Args:
        item: the object; its children move with it.
        spot: its new place.
        depsgraph: has its present place.

    Returns:
        Its new middle, in the world.
    """
    before = Vector(object_props(item).stands_on)
    turn = np.eye(4)
    normal = np.array(spot.normal)
    turn[:3, :3] = gravity.rotation_between(np.array(before), normal)
    points = _points(item, depsgraph)
    if not len(points):
        points = lookup.matrix_world(item)[None, :3, 3]
    points = points @ turn[:3, :3].T
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    lift = float((points @ normal).min() - middle @ normal)
    turn[:3, 3] = np.array(spot.point) - middle - lift * normal
    item.matrix_world = Matrix((turn @ lookup.matrix_world(item)).tolist())
    object_props(item).stands_on = spot.normal
    return spot.point - lift * spot.normal


def _points(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> NDArray[np.float64]:
    """(N, 3) corners of an object's surface and its children's, in the world."""
    family = [item, *item.children_recursive]
    own = [each for each in family if each.type in surfaces.TYPES and each.visible_get()]
    parts = [surfaces.corners(each.evaluated_get(depsgraph)) for each in own]
    return np.concatenate([np.empty((0, 3)), *parts])
