"""Charts of a mesh for its texture: flat pieces, packed into a square.

Each face is assigned to one of 14 directions that it faces well; neighbours prefer the same one.
Connected faces with the same direction form a chart, which is projected along it. So nothing is
stretched by more than a factor of about two. Libraries that stretch less (xatlas) took 30 s for
50,000 faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from ..model.scene import Float64
from .mesh import Mask, Mesh

ROUNDS = 8  # rounds in which faces adapt to the directions of their neighbours
SMOOTHINGS = 4  # rounds in which normals are averaged with those of neighbours
LISTENING = 0.3  # weight of a neighbour, as a cosine
LEAST_FACING = 0.1  # cosine between a face and its chart's direction
SMALL = 50  # faces; smaller charts join others whose direction they face at all
GUTTER = 2  # texels around each chart

Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Charts:
    """A mesh cut along the charts' borders.

    Attributes:
        vertex: (W,) the mesh's vertex at each corner of a chart.
        faces: (F, 3) the mesh's faces, as rows of corners.
        texels: (W, 2) places of corners in the texture, x to the right and y down.
        side: side of the texture, texels.
    """

    vertex: Ints
    faces: Ints
    texels: Float64
    side: int


def directions() -> Float64:
    """Return (14, 3) unit vectors to the sides and the corners of a cube."""
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3, indexing="ij"), float).reshape(3, -1).T
    both = np.concatenate([np.eye(3), -np.eye(3), signs])
    return _unit(both)


def charts_of(mesh: Mesh, side: int) -> Charts:
    """Return the charts of a mesh in a texture of `side` texels, as large as they fit."""
    ways = directions()
    a, b = _neighbours(mesh.faces)
    label = _labels(mesh, ways, a, b)
    chart = _connected(label, a, b)
    keys = (chart[:, None] * len(mesh.vertices) + mesh.faces).ravel()
    corners, faces = np.unique(keys, return_inverse=True)
    vertex, of_chart = corners % len(mesh.vertices), corners // len(mesh.vertices)
    way = np.zeros(chart.max() + 1, np.int64)
    way[chart] = label
    flat = _projected(mesh.vertices[vertex], ways[way[of_chart]])
    texels = _packed(flat, of_chart, side)
    return Charts(vertex=vertex, faces=faces.reshape(-1, 3), texels=texels, side=side)


def _neighbours(faces: Ints) -> tuple[Ints, Ints]:
    """Return pairs of faces that share an edge."""
    ends = np.sort(faces[:, (0, 1, 1, 2, 2, 0)].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (faces.max() + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    return order[pairs] // 3, order[pairs + 1] // 3


def _connected(label: Ints, a: Ints, b: Ints) -> Ints:
    """Return the chart (F,) of each face: connected faces of one label."""
    same = label[a] == label[b]
    n = len(label)
    joined = sparse.coo_matrix((np.ones(same.sum(), np.int8), (a[same], b[same])), shape=(n, n))
    return np.asarray(csgraph.connected_components(joined, directed=False)[1], dtype=np.int64)


def _labels(mesh: Mesh, ways: Float64, a: Ints, b: Ints) -> Ints:
    """Return the direction (F,) of each face: one that it faces well, and that neighbours have."""
    n, count = len(mesh.faces), len(ways)
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    link = sparse.csr_matrix((np.ones(2 * len(a)), ends), shape=(n, n))
    smooth = _unit(mesh.crosses)
    facing = smooth @ ways.T
    for _ in range(SMOOTHINGS):
        smooth = _unit(smooth + link @ smooth)
    score = facing / 2 + smooth @ ways.T
    score[facing < LEAST_FACING] -= 10

    def liked(label: Ints, among: Mask) -> Float64:
        rows = np.flatnonzero(among)
        chosen = sparse.csr_matrix((np.ones(len(rows)), (rows, label[rows])), shape=(n, count))
        return np.asarray((link @ chosen).toarray())

    label, every = score.argmax(axis=1), np.ones(n, bool)
    for _ in range(ROUNDS):
        label = (score + LISTENING * liked(label, every)).argmax(axis=1)
    for _ in range(ROUNDS):
        chart = _connected(label, a, b)
        small = np.bincount(chart)[chart] < SMALL
        others = np.where(facing > 0, liked(label, ~small), 0)
        label = np.where(small & (others.max(axis=1) > 0), others.argmax(axis=1), label)
    return np.asarray(label, dtype=np.int64)


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30))


def _projected(points: Float64, ways: Float64) -> Float64:
    """Project points (W, 3) along directions (W, 3); return (W, 2) in units of the scene."""
    helper = np.where(np.abs(ways[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]])
    right = np.cross(helper, ways)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(ways, right)
    return np.stack([(points * right).sum(1), (points * up).sum(1)], axis=1)


def _packed(flat: Float64, chart: Ints, side: int) -> Float64:
    """Return places (W, 2) in the texture: charts as large as fit, on shelves, tallest first."""
    count = chart.max() + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, flat)
    np.maximum.at(high, chart, flat)
    turned = (high - low)[:, 0] < (high - low)[:, 1]  # upright charts are laid down
    local = flat - low[chart]
    local = np.where(turned[chart, None], local[:, ::-1] * (1, -1), local)
    sizes = high - low
    sizes = np.where(turned[:, None], sizes[:, ::-1], sizes)
    local[:, 1] += np.where(turned, sizes[:, 1], 0)[chart]
    small, large = 0.0, side / max(float(sizes.max()), 1e-30)
    for _ in range(24):
        middle = (small + large) / 2
        fits = _shelves(sizes * middle, side) is not None
        small, large = (middle, large) if fits else (small, middle)
    corners = _shelves(sizes * small, side)
    assert corners is not None, "charts without a size fit"
    return np.asarray(local * small + corners[chart] + GUTTER)


def _shelves(sizes: Float64, side: int) -> Float64 | None:
    """Return corners (C, 2) of rectangles of `sizes` (C, 2) with gutters; None if too large."""
    whole = np.ceil(sizes) + 2 * GUTTER
    if whole.max() > side or whole.prod(axis=1).sum() > side * side:
        return None
    order = np.lexsort((-whole[:, 0], -whole[:, 1]))
    corners = np.zeros_like(whole)
    x = y = height = 0.0
    for k, (across, down) in zip(order.tolist(), whole[order].tolist(), strict=True):
        if x + across > side:
            x, y, height = 0.0, y + height, 0.0
        height = max(height, down)
        if y + height > side:
            return None
        corners[k] = x, y
        x += across
    return corners
