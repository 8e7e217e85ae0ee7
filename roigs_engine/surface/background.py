"""The surroundings of the boxes as one coarse mesh, for shadows, reflections and bounced light.

There is a coarse grid around all cameras and points, and there are finer grids around the boxes,
where objects will stand. The fine grids lie on the lattice of the coarse one, and each cell belongs
to one grid. The coarse mesh reaches one cell into the fine ones, so that no light leaks between.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.gravity import gravity_alignment
from ..formats.run_files import SURROUNDINGS
from ..formats.text import in_gb
from ..machine import ENGINE, machine_memory
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Float64, SfmScene
from ..photos.decode import load_photo
from .depth import DepthMap, depth_maps
from .fusion import COARSE, Field, footprint, fuse
from .make import Surface, SurfaceOptions
from .memory import FIELD_SHARE, PER_DEPTH, PER_GAUSSIAN, PER_TEXEL, PER_VOXEL
from .mesh import HOLE, Mask, Mesh, cut_out, decimated, shown
from .texture import FILLED, Load, textured

REACH = 4.0  # extents of the cameras from their middle; points farther away are left out
OUTLIERS = 0.005  # share of the points that is ignored at each side
MARGIN = 0.1  # of the size, at each side: where few photos show a floor, its depth scatters
MOST_PHOTOS, PHOTO_SIDE = 120, 640
VOXELS = 1 << 23  # most voxels of the coarse grid
NEAR_VOXELS = 1 << 22  # most voxels of all fine grids
AROUND = 0.5  # width of the fine grid around a box, in diagonals of the box
FINEST = 4  # most voxels of a fine grid in one of the coarse grid, along a side
WALL = 4.0  # height in voxels of the walls that hold a rim while the mesh is simplified
SMALLEST = 10  # voxels along a side; parts of a smaller area are floating noise
# The background is the same surface as a box's own mesh if all of this holds:
DOUBLE = 2.5  # .. it is less than so many voxels above or below that mesh,
ALIKE = 0.3  # .. the cosine of the normals is larger than this,
BESIDE = 0.3  # .. and it is less than so many voxels beside the mesh's rim
TEXTURE = 1024  # texels along a side
PICTURES, MOST_STEP = 40, 4  # most photos of the texture, and most factor by which they shrink
CHARTS = 200 << 20  # bytes for charts, and memory that reading the scene leaves in use


@dataclass(frozen=True, kw_only=True, eq=False)
class _Region:
    """A part of the coarse grid: cells from `low` to `high` (exclusive), (3,) each."""

    low: Any
    high: Any

    @property
    def count(self) -> int:
        return int(np.prod(self.high - self.low))


def surroundings(scene: SfmScene) -> OrientedBox:
    """Return an upright box around the cameras and the points, without far points.

    SceneError if the scene has no cameras.
    """
    centres = scene.centres()
    if not len(centres):
        raise SceneError("The scene has no cameras.", "Give a COLMAP project with photos.")
    middle = np.median(centres, axis=0)
    near = np.linalg.norm(scene.points - middle, axis=1) <= REACH * scene.extent()
    turn = gravity_alignment(np.array([image.world_to_camera for image in scene.images]))
    eyes, points = centres @ turn.T, scene.points[near] @ turn.T
    low, high = eyes.min(axis=0), eyes.max(axis=0)
    if len(points):
        ends = np.quantile(points, [OUTLIERS, 1 - OUTLIERS], axis=0)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    half = (high - low) * (0.5 + MARGIN)
    half = np.maximum(half, MARGIN * half.max())
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -(low + high) / 2
    return OrientedBox(name=SURROUNDINGS, world_to_box=matrix, half_extents=half)


def smaller_scene(scene: SfmScene) -> SfmScene:
    """Return a scene with fewer, evenly chosen, smaller photos, enough for a coarse mesh."""
    step = max(1, math.ceil(len(scene.images) / MOST_PHOTOS))
    images = tuple(
        image.scaled(min(1.0, PHOTO_SIDE / max(image.camera.width, image.camera.height)))
        for image in scene.images[::step]
    )
    return replace(scene, images=images)


@dataclass(frozen=True, kw_only=True)
class BackgroundPlan:
    """The memory plan: most voxels of the coarse grid, about how many bytes are used, and exist."""

    voxels: int
    memory: int
    machine: int

    @property
    def text(self) -> str:
        """Return the plan as one line for users."""
        return f"Memory: up to about {in_gb(self.memory)} of {in_gb(self.machine)}."


def background_plan(scene: SfmScene, gaussians: int, side: int = TEXTURE) -> BackgroundPlan:
    """Plan the memory of `make_background`.

    Args:
        scene: the run's scene.
        gaussians: number of Gaussians.
        side: side of the texture, texels.
    """
    machine = machine_memory()
    voxels = min(VOXELS, machine // FIELD_SHARE // PER_VOXEL)
    pixels = sum(i.camera.width * i.camera.height for i in smaller_scene(scene).images)
    work = PER_DEPTH * pixels + max(PER_VOXEL * voxels, PER_TEXEL * side**2)
    memory = ENGINE + CHARTS + PER_GAUSSIAN * gaussians + work
    return BackgroundPlan(voxels=voxels, memory=memory, machine=machine)


def make_background(
    gaussians: Gaussians,
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    own: Mapping[str, tuple[Float64, Float64]],
    options: SurfaceOptions,
    *,
    load: Load = load_photo,
    context: Context = QUIET,
) -> Surface:
    """Make a textured mesh of the surroundings of the boxes.

    Args:
        gaussians: the trained scene, on the context's device.
        scene: the photos, in the frame of the Gaussians and the boxes.
        rois: the boxes, around which the mesh is finer.
        own: box -> (N, 3) points all over the box's own mesh, and their unit normals; the
            background has no faces there.
        load: returns a photo, (H, W, 3) uint8 sRGB.

    Raises:
        SceneError: no photo shows a surface.
        EngineError: an optional package is not installed.
        Stopped: on request.
    """
    side = options.texture_size or TEXTURE
    plan = background_plan(scene, len(gaussians), side)
    whole, small = surroundings(scene), smaller_scene(scene)
    names = [image.name for image in small.images]
    found = depth_maps(gaussians, small, whole, names, context)
    maps = [depth_map for depth_map in found if depth_map.depth.any()]
    if not maps:
        raise SceneError("No photo shows a surface.", "Train the scene longer.")
    voxel = _voxel(maps, whole, plan.voxels)
    whole = _on_cells(whole, voxel)
    regions, finer = _regions(rois, whole, voxel, _finest(maps, voxel))
    coarse = _cut(fuse(maps, whole, voxel, context), whole, voxel, context)
    inner = [replace(region, low=region.low + 1, high=region.high - 1) for region in regions]
    coarse = coarse.kept(_owner(coarse, inner, whole, voxel) < 0)
    parts = [_near(maps, whole, regions, k, voxel, finer, context) for k in range(len(regions))]
    near = _without_doubles(_joined(parts), rois, own, voxel / finer)
    coarse = _without_doubles(coarse, rois, own, voxel)
    share = options.faces // 2
    room = share if len(near.faces) > share else options.faces - len(near.faces)
    meshes = ((coarse, room, voxel), (near, options.faces - room, voxel / finer))
    mesh = _joined([_simplified(*each) for each in meshes])
    mesh = replace(mesh, filled=~shown(mesh, maps, voxel, 1, context))
    mesh = _seen(_large(mesh, voxel))
    if not len(mesh.faces):
        raise SceneError("No photo shows a surface.", "Train the scene longer.")
    pictures = _coarser(maps[:: math.ceil(len(maps) / PICTURES)], mesh, side)
    picture = textured(mesh, pictures, side, load, context)
    return Surface(textured=picture, voxel=voxel, photos=len(maps))


def _voxel(maps: Sequence[DepthMap], whole: OrientedBox, most: int) -> float:
    """Return the side of a coarse voxel: a pixel of the median photo, or more for `most` voxels."""
    pixel = float(np.median([footprint(depth_map) for depth_map in maps]))
    return max(pixel, float((8 * np.prod(whole.half_extents) / most) ** (1 / 3)))


def _finest(maps: Sequence[DepthMap], voxel: float) -> int:
    """Return the factor by which voxels may be finer: down to a pixel of the nearest photos."""
    pixel = min(footprint(depth_map) for depth_map in maps)
    return int(np.clip(voxel / pixel, 1, FINEST))


def _on_cells(whole: OrientedBox, voxel: float) -> OrientedBox:
    """Enlarge the box to whole cells of the grid, so that it is the grid's box."""
    cells = np.ceil(2 * whole.half_extents / (COARSE * voxel) - 1e-9)
    return replace(whole, half_extents=cells * COARSE * voxel / 2)


def _regions(
    rois: Sequence[OrientedBox], whole: OrientedBox, voxel: float, finest: int
) -> tuple[list[_Region], int]:
    """Return regions with a finer grid, and their factor, less than `finest` if memory is short."""
    found = []
    most = np.round(2 * whole.half_extents / voxel).astype(int) - 1
    for roi in rois:
        corners = roi.corners() @ whole.world_to_box[:3, :3].T + whole.world_to_box[:3, 3]
        more = AROUND * roi.diagonal
        low = (corners.min(axis=0) - more + whole.half_extents) / voxel - 0.5
        high = (corners.max(axis=0) + more + whole.half_extents) / voxel - 0.5
        region = _Region(
            low=np.clip(np.floor(low), 0, most).astype(int),
            high=np.clip(np.ceil(high), 0, most).astype(int),
        )
        if (region.high > region.low).all():
            found.append(region)
    cells = sum(region.count for region in found)
    finer = min(finest, int((NEAR_VOXELS / max(cells, 1)) ** (1 / 3)))
    return (found, finer) if finer > 1 else ([], 1)


def _owner(mesh: Mesh, regions: Sequence[_Region], whole: OrientedBox, voxel: float) -> Any:
    """Return the first region (F,) that contains each face's cell; -1 if none does."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    local = middles @ whole.world_to_box[:3, :3].T + whole.world_to_box[:3, 3]
    cells = np.floor((local + whole.half_extents) / voxel - 0.5).astype(int)
    owner = np.full(len(cells), -1)
    for k in reversed(range(len(regions))):
        inside = (cells >= regions[k].low) & (cells < regions[k].high)
        owner[inside.all(axis=1)] = k
    return owner


def _near(
    maps: Sequence[DepthMap],
    whole: OrientedBox,
    regions: Sequence[_Region],
    index: int,
    voxel: float,
    finer: int,
    context: Context,
) -> Mesh:
    """Return the mesh of a region, from a finer grid."""
    region, fine = regions[index], voxel / finer
    # There are samples at both ends of the region, and more beyond, to fill the last cell.
    cells = np.ceil(((region.high - region.low) * finer + 1) / COARSE)
    half = cells * COARSE * fine / 2
    low = (region.low + 0.5) * voxel - whole.half_extents - fine / 2
    matrix = whole.world_to_box.copy()
    matrix[:3, 3] -= low + half
    box = OrientedBox(name=SURROUNDINGS, world_to_box=matrix, half_extents=half)
    mesh = _cut(fuse(maps, box, fine, context), box, fine, context)
    return mesh.kept(_owner(mesh, regions, whole, voxel) == index)


def _cut(field: Field, box: OrientedBox, voxel: float, context: Context) -> Mesh:
    """Return the surface of a field without small parts; it may be empty."""
    try:
        return _large(cut_out(field, box, context=context), voxel)
    except SceneError:
        return _joined([])


def _simplified(mesh: Mesh, faces: int, voxel: float) -> Mesh:
    """Simplify a mesh to at most about `faces` faces; its rims stay where they are.

    Merging edges would cut the corners off a flat part, and leave gaps between two grids. So each
    rim temporarily gets a wall at right angles to the mesh.
    """
    if len(mesh.faces) <= faces:
        return mesh
    n = len(mesh.vertices)
    a, b = mesh.faces[:, (0, 1, 2)].ravel(), mesh.faces[:, (1, 2, 0)].ravel()
    rim = ~np.isin(a * n + b, b * n + a)
    a, b = a[rim], b[rim]
    places, ends = np.unique(np.concatenate([a, b]), return_inverse=True)
    above = n + ends.reshape(2, -1)
    walls = np.concatenate([np.stack([b, a, above[0]], 1), np.stack([b, above[0], above[1]], 1)])
    tops = mesh.vertices[places] + WALL * voxel * mesh.normals()[places]
    walled = Mesh(
        vertices=np.concatenate([mesh.vertices, tops]),
        faces=np.concatenate([mesh.faces, walls]),
        filled=np.arange(len(mesh.faces) + len(walls)) >= len(mesh.faces),
    )
    found = decimated(walled, faces)
    return found.kept(~found.filled)


def _coarser(maps: Sequence[DepthMap], mesh: Mesh, side: int) -> list[DepthMap]:
    """Return the depth maps of photos reduced until a pixel is about as large as a texel."""
    texel = math.sqrt(float(mesh.areas.sum()) / FILLED) / side
    found = []
    for depth_map in maps:
        step = int(np.clip(texel / footprint(depth_map), 1, MOST_STEP))
        image = depth_map.image.scaled(1 / step)
        depth, weight = (a[::step, ::step].copy() for a in (depth_map.depth, depth_map.weight))
        found.append(
            replace(depth_map, image=image, camera=image.camera, depth=depth, weight=weight)
        )
    return found


def _large(mesh: Mesh, voxel: float) -> Mesh:
    """Remove parts of less than `SMALLEST` voxels along a side."""
    if not len(mesh.faces):
        return mesh
    parts = mesh.parts()
    return mesh.kept((np.bincount(parts, mesh.areas) >= (SMALLEST * voxel) ** 2)[parts])


def _seen(mesh: Mesh) -> Mesh:
    """Remove large parts that no photo shows: they are at the edges of the observed space."""
    if not mesh.filled.any():
        return mesh
    patches = np.where(mesh.filled, mesh.parts(mesh.filled), -1)
    areas = np.bincount(patches + 1, mesh.areas)
    large: Mask = areas[patches + 1] > HOLE * areas.sum()
    return mesh.kept(~(mesh.filled & large))


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one without merging vertices."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        vertices=np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)]),
        faces=np.concatenate(
            [np.zeros((0, 3), int), *(m.faces + n for m, n in zip(meshes, starts, strict=False))]
        ),
        filled=np.concatenate([np.zeros(0, bool), *(mesh.filled for mesh in meshes)]),
    )


def _without_doubles(
    mesh: Mesh,
    rois: Sequence[OrientedBox],
    own: Mapping[str, tuple[Float64, Float64]],
    voxel: float,
) -> Mesh:
    """Remove faces that the boxes' own meshes cover wholly, so that no gap is left between."""
    normals, covered = mesh.normals(), np.zeros(len(mesh.vertices), bool)
    for roi in rois:
        points, facing = own.get(roi.name, (np.zeros((0, 3)),) * 2)
        rows = np.flatnonzero(roi.distance(mesh.vertices) < DOUBLE * voxel)
        if not len(points) or not len(rows):
            continue
        nearest = cKDTree(points).query(mesh.vertices[rows])[1]
        away, up = mesh.vertices[rows] - points[nearest], facing[nearest]
        height = (away * up).sum(axis=1)
        beside = np.linalg.norm(away - height[:, None] * up, axis=1)
        near = (np.abs(height) < DOUBLE * voxel) & (beside < BESIDE * voxel)
        covered[rows] |= near & ((up * normals[rows]).sum(axis=1) > ALIKE)
    double = covered[mesh.faces].all(axis=1)
    return mesh.kept(~double) if double.any() else mesh
