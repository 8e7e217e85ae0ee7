"""Triangle mesh of a distance field: extracted, cleaned of floating parts, simplified, closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from ..context import QUIET, Context
from ..errors import SceneError
from ..machine import package
from ..model.roi import OrientedBox
from ..model.scene import Float64, project
from .depth import DepthMap
from .fusion import Field

PURPOSE = "A mesh"
SMOOTHING = 1.0  # standard deviation of the field's smoothing filter, voxels
PHOTOS = 2  # least number that show a surface, else it counts as filled
SMALLEST = 0.02  # least area of a part, relative to the largest; smaller parts are floating noise
HOLE = 0.01  # largest share of the area for a filled hole; larger holes stay open
FACING = 0.15  # least cosine between a face's normal and a ray that shows it
SLACK = 2.0  # most distance between a face and a depth that shows it, in sizes of pixel or voxel

Faces = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles in the frame of the scene.

    Attributes:
        vertices: (V, 3).
        faces: (F, 3) counter-clockwise as seen from outside.
        filled: (F,) whether no photo has shown the face.
    """

    vertices: Float64
    faces: Faces
    filled: Mask

    @property
    def crosses(self) -> Float64:
        """Return the normals (F, 3) of the faces, with twice their areas as lengths."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))

    @property
    def areas(self) -> Float64:
        """Return the areas (F,) of the faces, square units of the scene."""
        return np.asarray(np.linalg.norm(self.crosses, axis=1) / 2)

    def normals(self) -> Float64:
        """Return unit normals (V, 3) of the vertices: means of their faces' normals by area."""
        total = np.zeros_like(self.vertices)
        crosses = self.crosses
        for corner in range(3):
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.faces[:, corner], crosses[:, axis], len(self.vertices)
                )
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))

    def volume(self) -> float:
        """Return the volume in cubic units of the scene; it has a meaning if the mesh is closed."""
        return float(np.einsum("ij,ij->", self.vertices[self.faces[:, 0]], self.crosses) / 6)

    def is_closed(self) -> bool:
        """Whether each edge has two faces, in opposite directions."""
        a, b = self.faces[:, (0, 1, 2)].ravel(), self.faces[:, (1, 2, 0)].ravel()
        n = len(self.vertices)
        forth, back = np.sort(a * n + b), np.sort(b * n + a)
        return bool((forth[1:] > forth[:-1]).all() and (forth == back).all())

    def holes(self) -> Float64:
        """Return (H, 3) for each hole: its area, seen from the front, times its outward normal."""
        a, b = self.faces[:, (0, 1, 2)].ravel(), self.faces[:, (1, 2, 0)].ravel()
        n = len(self.vertices)
        rim = ~np.isin(a * n + b, b * n + a)
        a, b = a[rim], b[rim]
        graph = sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
        labels = csgraph.connected_components(graph, directed=False)[1][a]
        _, hole = np.unique(labels, return_inverse=True)
        crosses = np.cross(self.vertices[b], self.vertices[a]) / 2
        sums = [np.bincount(hole, crosses[:, axis], minlength=1) for axis in range(3)]
        return np.stack(sums, axis=1) if len(a) else np.zeros((0, 3))

    def kept(self, mask: Mask) -> Mesh:
        """Return the mesh of only the faces of a mask (F,)."""
        used, faces = np.unique(self.faces[mask], return_inverse=True)
        return Mesh(
            vertices=self.vertices[used],
            faces=faces.reshape(-1, 3).astype(np.int64),
            filled=self.filled[mask],
        )

    def parts(self, among: Mask | None = None) -> NDArray[np.int64]:
        """Return the number (F,) of each face's connected part; only faces of `among` connect."""
        faces = self.faces if among is None else self.faces[among]
        edges = np.concatenate([faces[:, :2], faces[:, 1:]]).T
        n = len(self.vertices)
        graph = sparse.coo_matrix((np.ones(edges.shape[1], np.int8), tuple(edges)), shape=(n, n))
        labels = csgraph.connected_components(graph, directed=False)[1]
        return np.asarray(labels[self.faces[:, 0]], dtype=np.int64)


def mesh_of(
    field: Field,
    roi: OrientedBox,
    maps: Sequence[DepthMap],
    *,
    closed: bool = False,
    context: Context = QUIET,
) -> Mesh:
    """Make the surface of a field, without floating parts and without layers inside.

    Args:
        maps: depth maps of the field; faces that fewer than two of them show count as filled.
        closed: whether the mesh has no holes: unseen parts are filled, also at the box's sides.

    Raises:
        SceneError: there is no surface in the box.
    """
    mesh = cut_out(field, roi, closed=closed, context=context)
    mesh = replace(mesh, filled=~shown(mesh, maps, field.voxel, PHOTOS, context))
    mesh = cleaned(mesh, closed=closed)
    if not len(mesh.faces) or mesh.filled.all():
        raise nothing_there(roi)
    return mesh


def cut_out(
    field: Field, roi: OrientedBox, *, closed: bool = False, context: Context = QUIET
) -> Mesh:
    """Return the whole surface of a field, uncleaned; raises the errors of `mesh_of`."""
    measure: Any = package("skimage.measure", PURPOSE, "scikit-image")
    context.check_cancelled()
    volume = ndimage.gaussian_filter(field.distance, SMOOTHING)
    if closed:
        volume = np.pad(volume, 1, constant_values=1.0)
    if not volume.min() < 0 < volume.max():
        raise nothing_there(roi)
    context.check_cancelled()
    places, faces, _, _ = measure.marching_cubes(volume, 0.0)
    places = places.astype(np.float64) - closed
    context.check_cancelled()
    to_world = np.linalg.inv(roi.world_to_box)
    local = places * field.voxel + field.origin
    vertices = local @ to_world[:3, :3].T + to_world[:3, 3]
    return Mesh(vertices=vertices, faces=faces.astype(np.int64), filled=np.zeros(len(faces), bool))


def shown(
    mesh: Mesh, maps: Sequence[DepthMap], voxel: float, photos: int, context: Context
) -> NDArray[np.bool_]:
    """Whether (F,) at least `photos` depth maps show each face, from in front and at its depth."""
    centres, normals = mesh.vertices[mesh.faces].mean(axis=1), mesh.crosses
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    views = np.zeros(len(centres), np.int64)
    left = np.arange(len(centres))  # faces that too few photos have shown yet; soon only some
    for depth_map in maps:
        context.check_cancelled()
        camera, pose = depth_map.lens, depth_map.world_to_camera
        away = centres[left] - depth_map.image.centre
        facing = -(away * normals[left]).sum(axis=1) / np.linalg.norm(away, axis=1)
        in_front = facing > FACING
        rows, facing = left[in_front], facing[in_front]
        pixels, depth, inside = project(centres[rows], camera, pose)
        rows, depth, facing = rows[inside], depth[inside], facing[inside]
        x, y = pixels[inside].astype(np.int64).T
        there = np.where(depth_map.weight > 0, depth_map.depth, 0)[y, x]
        slack = SLACK * np.maximum(depth / max(camera.fx, camera.fy), voxel) / facing
        views[rows[(there > 0) & (np.abs(there - depth) < slack)]] += 1
        left = left[views[left] < photos]
    return views >= photos


def nothing_there(roi: OrientedBox) -> SceneError:
    """Return the error for a box without a surface."""
    return SceneError(
        f"No photo shows a surface in box '{roi.name}'.", "Put the box around an object."
    )


def cleaned(mesh: Mesh, *, closed: bool) -> Mesh:
    """Remove small parts, hollows inside and, unless `closed`, large filled parts of a mesh."""
    mesh = _large_parts(_without_hollows(mesh))
    if closed or not mesh.filled.any():
        return mesh
    patches = np.where(mesh.filled, mesh.parts(mesh.filled), -1)
    areas = np.bincount(patches + 1, mesh.areas)
    large = areas[patches + 1] > HOLE * areas.sum()
    mesh = mesh.kept(~(mesh.filled & large))
    return _large_parts(mesh) if len(mesh.faces) else mesh


def _without_hollows(mesh: Mesh) -> Mesh:
    """Remove parts that are turned inside out: closed ones with a negative volume."""
    parts = mesh.parts()
    signed = np.einsum("ij,ij->i", mesh.vertices[mesh.faces[:, 0]], mesh.crosses)
    volumes = np.bincount(parts, signed)
    a, b = np.sort(mesh.faces[:, (0, 1, 2, 1, 2, 0)].reshape(-1, 2, 3).transpose(0, 2, 1)).T
    edges, counts = np.unique((a * len(mesh.vertices) + b).ravel(), return_counts=True)
    open_vertices = edges[counts == 1] // len(mesh.vertices)
    is_open = np.isin(mesh.faces, open_vertices).any(axis=1)
    has_hole = np.bincount(parts, is_open) > 0
    return mesh.kept((volumes[parts] > 0) | has_hole[parts])


def _large_parts(mesh: Mesh) -> Mesh:
    if not len(mesh.faces):
        return mesh
    parts = mesh.parts()
    areas = np.bincount(parts, mesh.areas * ~mesh.filled)
    return mesh.kept((areas >= SMALLEST * areas.max())[parts])


def simplified(mesh: Mesh, faces: int, context: Context = QUIET) -> Mesh:
    """Reduce a mesh to at most about `faces` faces (quadric errors, Garland and Heckbert 1997).

    A closed mesh stays closed, and may keep more faces for that. Parts cut off by merging are
    removed.
    """
    wanted, is_closed = faces, mesh.is_closed()
    while len(mesh.faces) > wanted:
        context.check_cancelled()
        found = _large_parts(decimated(mesh, wanted))
        if not is_closed or found.is_closed():
            return found
        wanted *= 2
    return mesh


def decimated(mesh: Mesh, faces: int) -> Mesh:
    """Reduce a mesh to about `faces` faces, if it has more; no parts are removed."""
    if len(mesh.faces) <= faces:
        return mesh
    library: Any = package("fast_simplification", PURPOSE, "fast-simplification")
    middle = mesh.vertices.mean(axis=0)
    vertices, triangles = library.simplify(
        mesh.vertices - middle, mesh.faces.astype(np.int32), target_count=faces
    )
    vertices = np.asarray(vertices, dtype=np.float64) + middle
    triangles = np.asarray(triangles, dtype=np.int64)
    before = mesh.vertices[mesh.faces].mean(axis=1)
    nearest = cKDTree(before).query(vertices[triangles].mean(axis=1))[1]
    return Mesh(vertices=vertices, faces=triangles, filled=mesh.filled[nearest])
