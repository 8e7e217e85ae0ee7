"""Makes the texture of a mesh, in two bands, from the photos that see a texel best.

Coarse colours are blended over all photos that see a texel, so that there are no seams. Fine detail
comes only from the best photos, so that slightly wrong poses do not blur it (Burt and Adelson
1983). Exposures are levelled before that: each photo gets a gain for each colour channel.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.scene import Float64, PosedImage
from ..photos.decode import Pixels
from ..rasterize.instances import NOTHING, surface_depth
from .charts import Charts, charts_of
from .depth import DepthMap
from .fusion import footprint
from .mesh import Mesh

STAGE = "texture"
BEST = 5  # percentile of the photos' pixel sizes that a texture resolves
FINER = 1.5  # texels for such a pixel, along a side
SMALLEST, LARGEST = 256, 8192  # texels
FILLED = 0.35  # share of a texture that charts take
LEAST_FACING = 0.15  # cosine between the surface's normal and the ray
SHARP = 2  # power of the weights in the fine band
BROAD = 2.0  # standard deviation that separates the bands, pixels of the best photos
FINE_DEPTH = 2  # the mesh's depth is drawn so many times finer than the photo
HIDDEN = 3.0  # pixel sizes behind the nearest face that hide a point; twice that behind the depth
GAINS = 0.6, 1.6
ACROSS = 3  # pixels that a colour between pixels depends on
PAIRS_AT_ONCE = 1 << 19

Float32 = NDArray[np.float32]
Load = Callable[[PosedImage], Pixels]


@dataclass(frozen=True, kw_only=True, eq=False)
class Textured:
    """A mesh with a texture.

    Attributes:
        mesh: the mesh.
        charts: the mesh's charts in the texture.
        picture: (S, S, 3) uint8 sRGB, the first row on top.
        seen: share of the charts' texels that a photo has coloured.
    """

    mesh: Mesh
    charts: Charts
    picture: Pixels
    seen: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Points:
    """Places on the surface (N, 3), and their unit normals."""

    places: Float64
    normals: Float64


def texture_side(mesh: Mesh, maps: Sequence[DepthMap]) -> int:
    """Return the side of a texture that resolves the best photos' pixels, texels."""
    pixel = _best_pixel(maps) / FINER
    if not math.isfinite(pixel):
        return SMALLEST
    side = math.sqrt(float(mesh.areas.sum()) / FILLED) / pixel
    return int(np.clip(2 ** round(math.log2(max(side, 1))), SMALLEST, LARGEST))


def _best_pixel(maps: Sequence[DepthMap]) -> float:
    """Return the size on the surface of a pixel of the best photos; infinite without any."""
    return float(np.percentile([footprint(m) for m in maps], BEST, method="lower"))


def textured(
    mesh: Mesh, maps: Sequence[DepthMap], side: int, load: Load, context: Context = QUIET
) -> Textured:
    """Make a texture of `side` texels for a mesh from the photos of the depth maps.

    Args:
        mesh: in the frame of the maps.
        maps: depth maps of the photos to use; where the depth is nearer, the mesh is hidden.
        load: returns a photo, (H, W, 3) uint8 sRGB.
    """
    charts = charts_of(mesh, side)
    texels, face, share = _texels(charts)
    normals = mesh.normals()
    corners = mesh.faces[face]
    at = np.einsum("nk,nkd->nd", share, mesh.vertices[corners])
    facing = np.einsum("nk,nkd->nd", share, normals[corners])
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-30)
    triangles = torch.from_numpy(mesh.vertices[mesh.faces].astype(np.float32))
    points = _Points(places=at, normals=facing)
    context.emit(StageStarted(stage=STAGE, total=2 * len(maps)))
    centres = _Points(places=mesh.vertices, normals=normals)
    views = [_View(depth_map, triangles, load) for depth_map in maps]
    gains = _gains(views, centres, context)
    colours, weight = _blended(views, points, gains, context)
    seen = weight > 0
    if seen.any() and not seen.all():
        nearest = cKDTree(at[seen]).query(at[~seen])[1]
        colours[~seen] = colours[seen][nearest]
    picture = np.zeros((side, side, 3), np.uint8)
    drawn = np.zeros((side, side), bool)
    picture[texels[:, 1], texels[:, 0]] = np.clip(colours, 0, 255).round()
    drawn[texels[:, 1], texels[:, 0]] = True
    if drawn.any():
        near = ndimage.distance_transform_edt(~drawn, return_distances=False, return_indices=True)
        picture = picture[tuple(near)]
    return Textured(
        mesh=mesh,
        charts=charts,
        picture=picture,
        seen=float(seen.mean()),
    )


class _View:
    """A photo, and the mesh as the photo sees it."""

    def __init__(self, depth_map: DepthMap, triangles: torch.Tensor, load: Load) -> None:
        self.map, self._triangles, self._load = depth_map, triangles, load
        self._counted = depth_map.counted(ACROSS)
        self.drawn = np.zeros((depth_map.camera.height, depth_map.camera.width), np.float32)
        """Where the mesh is, 1, as of the last call of `sees`."""

    def pixels(self) -> Float32:
        """Return the part (H, W, 3) of the photo that shows the box, 0 to 255."""
        m = self.map
        whole = self._load(m.image)
        return whole[m.y : m.y + m.camera.height, m.x : m.x + m.camera.width, :3].astype(np.float32)

    def sees(self, points: _Points) -> tuple[NDArray[np.int64], Float64, Float64]:
        """Return points that the photo shows: rows, pixels (M, 2) from the part's corner, weights.

        The weight is the cosine between ray and normal, over the square of the pixel's size.
        """
        m, camera = self.map, self.map.camera
        pose = m.world_to_camera
        local = points.places @ pose[:3, :3].T + pose[:3, 3]
        z = local[:, 2]
        with np.errstate(all="ignore"):
            pixels = local[:, :2] / z[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
            size = np.array([camera.width, camera.height])
            inside = (z > 0) & ((pixels > 1) & (pixels < size - 1)).all(axis=1)
        rows = np.flatnonzero(inside)
        local, pixels, z = local[rows], pixels[rows], z[rows]
        normals = points.normals[rows] @ pose[:3, :3].T
        cosine = -(normals * local).sum(axis=1) / np.linalg.norm(local, axis=1)
        pixel = z / max(camera.fx, camera.fy)
        fine = camera.resized(camera.width * FINE_DEPTH, camera.height * FINE_DEPTH)
        nearest = surface_depth(self._triangles, fine, pose).numpy()
        self.drawn = (nearest[::FINE_DEPTH, ::FINE_DEPTH] < NOTHING).astype(np.float32)
        if self._counted is not None:
            self.drawn *= self._counted
        nearest = ndimage.minimum_filter(nearest, 3)
        x, y = np.floor(pixels * FINE_DEPTH).astype(int).T
        # Within a pixel, the depth of a face at a grazing angle varies much.
        slack = HIDDEN * pixel / np.maximum(cosine, LEAST_FACING)
        shown = (cosine > LEAST_FACING) & (z < nearest[y, x] + slack)
        x, y = np.floor(pixels).astype(int).T
        if self._counted is not None:
            shown &= self._counted[y, x]
        height, width = m.depth.shape
        at = y * height // camera.height, x * width // camera.width
        front = m.depth[at]
        shown &= ((front == 0) | (z < front + 2 * slack)) & (m.weight[at] >= 0)
        kept = np.flatnonzero(shown)
        return rows[kept], pixels[kept], (cosine / pixel**2)[kept]


def _sampled(picture: Float32, pixels: Float64) -> Float32:
    """Sample a picture (H, W, 3) at places (M, 2), bilinearly; return (M, 3)."""
    places = pixels.T[::-1] - 0.5
    channels = (picture[..., k] for k in range(3))
    sampled = [ndimage.map_coordinates(c, places, order=1, mode="nearest") for c in channels]
    return np.stack(sampled, axis=1)


def _gains(views: Sequence[_View], points: _Points, context: Context) -> Float64:
    """Return factors (P, 3) for each photo's colours with which the photos agree on the points."""
    gains = np.ones((len(views), 3))
    found = []
    started = time.monotonic()
    for step, view in enumerate(views, start=1):
        context.check_cancelled()
        rows, pixels, weights = view.sees(points)
        colours = _sampled(ndimage.gaussian_filter(view.pixels(), (1, 1, 0)), pixels)
        found.append((rows, np.log(colours.astype(np.float64) + 8), weights))
        context.progress(STAGE, step, 2 * len(views), started)
    for _ in range(3):
        total = np.full((len(points.places), 3), 1e-12)
        weight = np.full(len(points.places), 1e-12)
        for (rows, colours, weights), gain in zip(found, gains, strict=True):
            total[rows] += weights[:, None] * (colours + np.log(gain))
            weight[rows] += weights
        mean = total / weight[:, None]
        for k, (rows, colours, _) in enumerate(found):
            if len(rows) > 50:
                gains[k] = np.exp(np.median(mean[rows] - colours, axis=0))
        gains = np.clip(gains / np.exp(np.log(gains).mean(axis=0)), *GAINS)
    return gains


def _blended(
    views: Sequence[_View], points: _Points, gains: Float64, context: Context
) -> tuple[Float32, Float32]:
    """Return colours (N, 3) of points, 0 to 255, and weights (N,), 0 where no photo shows them."""
    n = len(points.places)
    broad, fine = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
    broad_weight, fine_weight = np.zeros(n, np.float32), np.zeros(n, np.float32)
    best = None
    broad_size = BROAD * _best_pixel([view.map for view in views])
    started = time.monotonic()
    for step, (view, gain) in enumerate(zip(views, gains, strict=True), start=1):
        context.check_cancelled()
        rows, pixels, weights = view.sees(points)
        if len(rows):
            best = float(weights.max()) if best is None else best
            weights = (weights / best).astype(np.float32)
            picture = view.pixels() * gain.astype(np.float32)
            low = _sampled(_blurred(picture, view.drawn, broad_size / footprint(view.map)), pixels)
            high = _sampled(picture, pixels) - low
            sharp = weights**SHARP
            broad[rows] += weights[:, None] * low
            broad_weight[rows] += weights
            fine[rows] += sharp[:, None] * high
            fine_weight[rows] += sharp
        context.progress(STAGE, len(views) + step, 2 * len(views), started)
    colours = broad / np.maximum(broad_weight, 1e-30)[:, None]
    colours += fine / np.maximum(fine_weight, 1e-30)[:, None]
    return colours, broad_weight


def _blurred(picture: Float32, mask: Float32, size: float) -> Float32:
    """Return the broad colours (H, W, 3) within a mask (H, W); other pixels do not count.

    Args:
        size: standard deviation, pixels. It is the same size on the surface for all photos, so
            that the bands of near and far photos end at the same detail.
    """
    part = ndimage.gaussian_filter(picture * mask[..., None], (size, size, 0))
    share = ndimage.gaussian_filter(mask, size)
    return np.asarray(part / np.maximum(share, 1e-12)[..., None], dtype=np.float32)


def _texels(charts: Charts) -> tuple[NDArray[np.int64], NDArray[np.int64], Float64]:
    """Return the texels in charts: (N, 2) x and y, (N,) face, (N, 3) shares of its corners."""
    corners = charts.texels[charts.faces]  # (F, 3, 2)
    low = np.floor(corners.min(axis=1)).astype(int)
    spans = np.floor(corners.max(axis=1)).astype(int) - low + 1
    counts = spans.prod(axis=1)
    ends = np.cumsum(counts)
    found = []
    first = 0
    while first < len(counts):
        done = ends[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(ends, done + PAIRS_AT_ONCE, "right")))
        part = slice(first, last)
        face = np.repeat(np.arange(first, last), counts[part])
        inner = np.arange(len(face)) - np.repeat(ends[part] - counts[part] - done, counts[part])
        x, y = low[face, 0] + inner % spans[face, 0], low[face, 1] + inner // spans[face, 0]
        share = _shares(corners[face], np.stack([x, y], axis=1) + 0.5)
        inside = (share >= -0.5 / 16).all(axis=1)
        found.append((np.stack([x, y], axis=1)[inside], face[inside], share[inside]))
        first = last
    texels, face, share = (np.concatenate(each) for each in zip(*found, strict=True))
    _, once = np.unique(texels[:, 1] * charts.side + texels[:, 0], return_index=True)
    share = np.clip(share[once], 0, 1)
    return texels[once], face[once], share / share.sum(axis=1, keepdims=True)


def _shares(corners: Float64, places: Float64) -> Float64:
    """Return barycentric coordinates (N, 3) of places (N, 2) in triangles (N, 3, 2)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cross(b - a, c - a)
    with np.errstate(all="ignore"):
        u, v = np.cross(b - places, c - places) / area, np.cross(c - places, a - places) / area
        share = np.stack([u, v, 1 - u - v], axis=1)
    return np.where(np.isfinite(share), share, -1.0)
