"""Fits a mesh to its photos: moves it along its normals to where the photos agree.

The Gaussians' surface is about a pixel of the best photos inside the object, everywhere. A single
patch matched between photos gives the place of the surface only roughly, and sometimes wrongly
(plane sweep, Collins 1996; oriented patches, Furukawa and Ponce 2010). The sum of the correlations
of a neighbourhood has a sharp peak. So a mesh gets one smooth field of offsets.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.roi import OrientedBox
from ..model.scene import Float64, project
from .depth import DepthMap
from .mesh import Mesh
from .texture import Load

STAGE = "fit"
POINTS = 4000  # patches on the mesh
PHOTOS = 3  # photos that show a patch best; they are compared
SIDE = 7  # side of a patch, pixels of the best photo
FARTHEST, STEP = 4.0, 0.5  # largest offset that is tried, and their steps, in these pixels
NEIGHBOURS = 40  # patches whose agreement is summed up
FACING = 0.3  # least cosine between ray and normal
HIDDEN = 3.0  # distance from the depth, in sizes of a pixel, from which a patch is hidden
PLAIN = 2.0  # levels of 255; patches with a smaller standard deviation are not used
WIDEST, NARROW = 0.9, 0.3  # sine of the angle between two rays: largest; less weight below
PEAK = 0.02  # least correlation of the best offset above the median one
AT_ONCE = 512  # patches whose colours are read at once: 60 MB
ALIKE, SAME_SIDE = 0.7, 0.0  # least cosine of normals, of patches, and of a vertex and a patch
PRIOR = 0.01  # weight of an offset of 0, in patches' correlations

Float32 = NDArray[np.float32]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Patches:
    """Squares (N) on a mesh, across its normals, and the photos that show them best.

    Attributes:
        places, normals: (N, 3).
        photos: (PHOTOS, N) rows of depth maps, the best first.
        pixels: (PHOTOS, N) sizes of their pixels there; infinite if fewer photos show the patch.
    """

    places: Float64
    normals: Float64
    photos: Ints
    pixels: Float64

    @property
    def size(self) -> Float64:
        """Return the size (N,) of the best photo's pixels; 0 if no photo shows a patch."""
        return np.where(np.isfinite(self.pixels[0]), self.pixels[0], 0.0)


def fitted(
    mesh: Mesh, maps: Sequence[DepthMap], roi: OrientedBox, load: Load, context: Context = QUIET
) -> Mesh:
    """Move a mesh to where its photos agree, by at most four pixels of the best of them.

    It stays in place where photos have no detail, and where it would leave its box.

    Args:
        mesh: in the frame of the maps and the box.
        load: returns a photo, (H, W, 3) uint8 sRGB.
    """
    if not mesh.areas[~mesh.filled].sum() > 0:
        return mesh
    patches = _patches(mesh, maps)
    colours = _colours(patches, maps, load, context)
    centres = np.array([depth_map.image.centre for depth_map in maps])
    scores, weights = _agreement(patches, colours, centres)
    tree = cKDTree(patches.places)
    near = _Neighbours(tree, patches, patches.places, patches.normals, ALIKE)
    offsets, sure = _best(near.sums(scores), near.sums(weights[:, None])[:, 0])
    sure[patches.size == 0] = 0
    # Moves are vectors, because the mesh's own normals are noise at the rims of holes.
    moves = (sure * offsets * patches.size)[:, None] * patches.normals
    here = _Neighbours(tree, patches, mesh.vertices, mesh.normals(), SAME_SIDE)
    total = here.sums(np.column_stack([moves, sure]))
    moved = mesh.vertices + total[:, :3] / (total[:, 3:] + PRIOR)
    before, after = (np.abs(roi.to_box(places)) for places in (mesh.vertices, moved))
    leaves = (after > np.maximum(before, 1)).any(axis=1)
    moved[leaves] = mesh.vertices[leaves]
    return replace(mesh, vertices=moved)


def _patches(mesh: Mesh, maps: Sequence[DepthMap]) -> _Patches:
    areas = np.where(mesh.filled, 0, mesh.areas)
    rng = np.random.default_rng(0)
    faces = rng.choice(len(areas), POINTS, p=areas / areas.sum())
    shares = rng.dirichlet((1.0, 1.0, 1.0), POINTS)
    corners = mesh.faces[faces]
    places = np.einsum("nk,nkd->nd", shares, mesh.vertices[corners])
    normals = np.einsum("nk,nkd->nd", shares, mesh.normals()[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    weights = np.zeros((max(len(maps), PHOTOS), POINTS))
    sizes = np.full_like(weights, np.inf)
    for k, depth_map in enumerate(maps):
        rows, size, facing = _shown(places, normals, depth_map)
        weights[k, rows], sizes[k, rows] = facing / size**2, size
    photos = np.argsort(-weights, axis=0, kind="stable")[:PHOTOS]
    pixels = np.take_along_axis(sizes, photos, axis=0)
    return _Patches(places=places, normals=normals, photos=photos, pixels=pixels)


def _shown(places: Float64, normals: Float64, depth_map: DepthMap) -> tuple[Ints, Float64, Float64]:
    """Return rows of patches that a photo shows whole, and the pixels' size and cosine there."""
    camera, pose = depth_map.camera, depth_map.world_to_camera
    away = places - depth_map.image.centre
    facing = -(away * normals).sum(axis=1) / np.linalg.norm(away, axis=1)
    pixels, depth, inside = project(places, camera, pose)
    size = np.array([camera.width, camera.height])
    inside &= (facing > FACING) & ((pixels > SIDE) & (pixels < size - SIDE)).all(axis=1)
    rows = np.flatnonzero(inside)
    shape = depth_map.depth.shape[::-1]
    x, y = (pixels[rows] * shape / size).astype(np.int64).T
    front = np.where(depth_map.weight > 0, depth_map.depth, 0)[y, x]
    pixel = depth[rows] / max(camera.fx, camera.fy)
    there = np.abs(front - depth[rows]) < HIDDEN * pixel / facing[rows]
    if (counted := depth_map.counted(2 * SIDE + 1)) is not None:
        x, y = pixels[rows].astype(np.int64).T
        there &= counted[y, x]
    return rows[there], pixel[there], facing[rows[there]]


def _offsets() -> Float64:
    return np.arange(-FARTHEST, FARTHEST + STEP / 2, STEP)


def _colours(patches: _Patches, maps: Sequence[DepthMap], load: Load, context: Context) -> Float32:
    """Return grey values (PHOTOS, N, offsets, SIDE²) of patches moved along their normals."""
    normals, size = patches.normals, patches.size
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, axis)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    down = np.cross(normals, across)
    grid = np.arange(SIDE) - SIDE // 2
    u, v = (each.reshape(-1, 1) for each in np.meshgrid(grid, grid))
    steps = _offsets()
    found = np.zeros((PHOTOS, len(normals), len(steps), SIDE**2), np.float32)
    context.emit(StageStarted(stage=STAGE, total=len(maps)))
    started = time.monotonic()
    for k, depth_map in enumerate(maps):
        context.check_cancelled()
        best, rows = np.nonzero((patches.photos == k) & np.isfinite(patches.pixels))
        grey = _grey(depth_map, load) if len(rows) else None
        for first in range(0, len(rows), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            row = rows[some, None, None]
            flat = u * across[row] + v * down[row]
            moved = flat + steps[:, None, None] * normals[row]
            places = (patches.places[row] + size[row, None] * moved).reshape(-1, 3)
            pixels = project(places, depth_map.camera, depth_map.world_to_camera)[0]
            values = ndimage.map_coordinates(grey, pixels.T[::-1] - 0.5, order=1, mode="nearest")
            found[best[some], rows[some]] = values.reshape(-1, len(steps), SIDE**2)
        context.progress(STAGE, k + 1, len(maps), started)
    return found


def _grey(depth_map: DepthMap, load: Load) -> Float32:
    part, camera = load(depth_map.image), depth_map.camera
    rows = slice(depth_map.y, depth_map.y + camera.height)
    columns = slice(depth_map.x, depth_map.x + camera.width)
    grey = part[rows, columns, :3].astype(np.float32).mean(axis=2)
    return np.asarray(ndimage.gaussian_filter(grey, 0.5))


def _agreement(patches: _Patches, colours: Float32, centres: Float64) -> tuple[Float64, Float64]:
    """Return sums (N, offsets) of correlations of pairs of photos, and (N,) of pairs' weights."""
    colours = colours - colours.mean(axis=-1, keepdims=True)
    contrast = np.sqrt((colours**2).mean(axis=-1))
    colours /= np.maximum(contrast, PLAIN)[..., None]
    rays = centres[np.minimum(patches.photos, len(centres) - 1)] - patches.places
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    count = len(patches.places)
    scores, total = np.zeros((count, colours.shape[2])), np.zeros(count)
    for a, b in combinations(range(PHOTOS), 2):
        pixels = patches.pixels[[a, b]]
        sine = np.linalg.norm(np.cross(rays[a], rays[b]), axis=1)
        useful = np.isfinite(pixels).all(axis=0) & (sine < WIDEST)
        useful &= (contrast[[a, b]].mean(axis=2) > PLAIN).all(axis=0)
        rows = np.flatnonzero(useful)
        pixels = pixels[:, rows]
        weight = np.minimum(sine[rows] / NARROW, 1) * pixels.min(axis=0) / pixels.max(axis=0)
        scores[rows] += weight[:, None] * (colours[a, rows] * colours[b, rows]).mean(axis=-1)
        total[rows] += weight
    return scores, total


class _Neighbours:
    """The patches around places of a mesh that face like these places, and their weights."""

    def __init__(
        self, tree: cKDTree, patches: _Patches, places: Float64, normals: Float64, alike: float
    ) -> None:
        away, self._near = tree.query(places, k=NEIGHBOURS)
        weight = np.exp(-2 * (away / np.maximum(away[:, -1:], 1e-30)) ** 2)
        cosine = np.einsum("nkd,nd->nk", patches.normals[self._near], normals)
        self._weights = weight * (cosine > alike)

    def sums(self, values: Float64) -> Float64:
        """Return sums (P, M) of the patches' values (N, M) around each place."""
        return np.asarray(np.einsum("pk,pkm->pm", self._weights, values[self._near]))


def _best(scores: Float64, weights: Float64) -> tuple[Float64, Float64]:
    """Return the offsets (N,) with the largest score, pixels, and their certainty; 0 for none."""
    offsets, rows = _offsets(), np.arange(len(scores))
    scores = scores / np.maximum(weights, 1e-30)[:, None]
    best = scores.argmax(axis=1)
    inner = (best > 0) & (best < len(offsets) - 1)
    middle = best.clip(1, len(offsets) - 2)
    before, at, after = (scores[rows, middle + k] for k in (-1, 0, 1))
    bend = np.minimum(before - 2 * at + after, -1e-12)
    found = offsets[middle] + STEP * np.clip((before - after) / (2 * bend), -0.5, 0.5)
    peak = at - np.median(scores, axis=1)
    return found, np.where(inner & (peak > PEAK), peak * weights, 0)
