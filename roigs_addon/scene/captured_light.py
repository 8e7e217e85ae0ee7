"""The light on a captured object when it was photographed, at each vertex of its mesh.

It comes from a panorama around the object: the light of each vertex' surroundings. If the object
itself hides them, its own mean colour is used. Shadows of single lamps on the object remain
unknown.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from mathutils.kdtree import KDTree
from numpy.typing import NDArray

from ..blender import mesh_of
from ..geometry import irradiance
from ..geometry.frames import Matrix
from . import clouds
from .splat_attributes import PLACE, values

Float32 = NDArray[np.float32]

ATTRIBUTE = "captured_light"
"""Vertex attribute: the colour a white matt surface would have had there, in linear light."""
SAMPLES, RAYS = 3000, 64
"""Number of sampled vertices, and of rays from each. The rays measure how much of the surroundings
the object itself hides. Each vertex takes the mean of the `NEAREST` samples."""
NEAREST = 6
SEED = 0
APART = 1e-3
"""Distance from the surface at which rays start, as a share of the object's size."""


def places_of(mesh: bpy.types.Mesh) -> Float32:
    """(V, 3) where vertices were captured, in the COLMAP frame, wherever the object is now."""
    imported = values(mesh, PLACE)
    return clouds.positions_of(mesh) if imported is None else imported


def middle_of(item: bpy.types.Object) -> tuple[float, float, float]:
    """Return the centre of an object's captured vertices, in the COLMAP frame."""
    places = places_of(mesh_of(item))
    x, y, z = ((places.max(axis=0) + places.min(axis=0)) / 2).tolist()
    return x, y, z


def store(mesh: bpy.types.Mesh, picture: Float32, turn: Matrix, own: Float32) -> None:
    """Give a mesh's vertices the attribute `ATTRIBUTE`.

    Args:
        mesh: of the object.
        picture: (H, W, 3) linear light all around it.
        turn: (3, 3) from the axes of the COLMAP frame to the picture's.
        own: (3,) the object's mean colour, linear.
    """
    places, triangles = places_of(mesh), _triangles(mesh)
    normals = _normals(places, triangles)
    seen = _open(places, triangles, normals)[:, None]
    turned = (normals @ turn.T).astype(np.float32)
    light = seen * irradiance.on_normals(picture, turned) + (1 - seen) * own
    if (old := mesh.attributes.get(ATTRIBUTE)) is not None:
        mesh.attributes.remove(old)
    full = np.ones((len(light), 4), np.float32)
    full[:, :3] = light
    clouds.set_attribute(mesh, ATTRIBUTE, "FLOAT_COLOR", full)
    mesh.update()


def is_stored(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh has the attribute. A recreated mesh does not."""
    return ATTRIBUTE in mesh.attributes


def _triangles(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    mesh.calc_loop_triangles()
    flat = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", flat)
    return flat.reshape(-1, 3)


def _normals(places: Float32, triangles: NDArray[np.int32]) -> Float32:
    """(V, 3) normals of vertices, weighted by the areas of their triangles."""
    a, b, c = (places[triangles[:, k]] for k in range(3))
    crosses = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corners, count = triangles.ravel(), len(places)
    sums = [np.bincount(corners, crosses[:, axis], count) for axis in range(3)]
    normals = np.stack(sums, axis=-1).astype(np.float32)
    lengths: Float32 = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals / lengths


def _open(places: Float32, triangles: NDArray[np.int32], normals: Float32) -> Float32:
    """(V,) cosine-weighted share of the surroundings that the object itself does not hide."""
    count = len(places)
    chosen = np.random.default_rng(SEED).permutation(count)[:SAMPLES]
    tree: Any = BVHTree.FromPolygons(places.tolist(), triangles.tolist(), all_triangles=True)
    turned = irradiance.frames(normals[chosen]) @ irradiance.hemisphere(RAYS).T
    apart = APART * float(np.ptp(places, axis=0).max())
    nodes, shares = KDTree(len(chosen)), np.empty(len(chosen), np.float32)
    for number, (vertex, ways) in enumerate(zip(chosen, turned, strict=True)):
        start = Vector((places[vertex] + apart * normals[vertex]).tolist())
        hits = sum(tree.ray_cast(start, Vector(way))[0] is not None for way in ways.T.tolist())
        shares[number] = 1 - hits / RAYS
        nodes.insert(places[vertex].tolist(), number)
    nodes.balance()
    near = [[found[1] for found in nodes.find_n(place, NEAREST)] for place in places.tolist()]
    return np.asarray(shares[np.array(near)].mean(axis=1), np.float32)
