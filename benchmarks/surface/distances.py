"""Distances between a surface and the true one: precision, recall, F, medians, normals.

Precision, recall and F are those of Knapitsch et al. 2017 ("Tanks and Temples"): the shares of
points of one surface that are within a distance of the other, and their harmonic mean.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from roigs_engine.model.scene import Camera, Float64, PosedImage, project
from roigs_engine.rasterize.instances import surface_depth

Triangles = NDArray[np.float32]

SAMPLES = 100_000
"""Points on each surface that distances are measured from; 5 times as many are looked up."""
WITHIN = (0.001, 0.002, 0.005)
NEAREST = 4  # samples whose triangles are tried for the nearest point
CONTACT = 0.006  # this far above what an object stands on, it and the support are not told apart
FINER = 2  # times a photo's resolution, of the depth that says what it sees
SLACK, SLACK_PIXELS = 0.0005, 0.25  # metres and pixels behind the nearest surface: still seen
FARTHEST = 2.0  # pixels of depth between a sample and its plane at its pixel's centre
LEAST_VIEWS = 2
ROUNDS = 10  # of an alignment
STEEPEST = 0.2  # least cosine of the angle at which a photo sees a surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Random points of a surface, evenly spread.

    Attributes:
        points, normals: (N, 3); normals have unit length.
        faces: (N,) the rows of their triangles.
    """

    points: Float64
    normals: Float64
    faces: NDArray[np.int64]

    def rows(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Samples:
        """Some of them."""
        return Samples(
            points=self.points[which], normals=self.normals[which], faces=self.faces[which]
        )


@dataclass(frozen=True, kw_only=True)
class Scores:
    """A surface against the true one; lengths in metres, angles in degrees.

    Attributes:
        precision, recall, f: at each distance of `WITHIN`.
        off: median and 95th percentile of the distances to the true surface.
        missed: the same, from the true surface to this one.
        normals: median error where the true surface is within the largest of `WITHIN`.
        seen: share of the true surface that photos can see.
    """

    precision: tuple[float, ...]
    recall: tuple[float, ...]
    f: tuple[float, ...]
    off: tuple[float, float]
    missed: tuple[float, float]
    normals: float
    seen: float


def sampled(triangles: Triangles, count: int, seed: int = 0) -> Samples:
    """Random points on (T, 3, 3) triangles."""
    corners = triangles.astype(np.float64)
    a, b, c = corners.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    doubled = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(seed)
    faces = rng.choice(len(corners), count, p=doubled / doubled.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = a[faces] + u * (b - a)[faces] + v * (c - a)[faces]
    return Samples(
        points=points, normals=normals[faces] / doubled[faces, None], faces=faces.astype(np.int64)
    )


def views_of(
    samples: Samples, scene: Triangles, images: Iterable[PosedImage]
) -> tuple[NDArray[np.int64], Float64]:
    """Number of photos that see each sample, and its normal, turned to where it is seen from.

    Args:
        samples: of a surface that belongs to the scene.
        scene: (T, 3, 3) all that can hide it.
        images: the photos.
    """
    count, towards = np.zeros(len(samples.points), np.int64), np.zeros_like(samples.points)
    shapes = torch.from_numpy(scene)
    for image in images:
        camera = image.camera.resized(FINER * image.camera.width, FINER * image.camera.height)
        pixels, depth, inside = project(samples.points, camera, image.world_to_camera)
        rays = image.centre - samples.points
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        cosine = np.abs((rays * samples.normals).sum(axis=1))
        rows = np.nonzero(inside & (cosine > STEEPEST))[0]
        if not len(rows):
            continue
        x, y = pixels[rows].astype(np.int64).T
        nearest = surface_depth(shapes, camera, image.world_to_camera).numpy()[y, x]
        slack = SLACK + depth[rows] / camera.fx * SLACK_PIXELS
        rows = rows[_at_centres(samples.rows(rows), camera, image) < nearest + slack]
        count[rows] += 1
        towards[rows] += rays[rows]
    flipped = (towards * samples.normals).sum(axis=1, keepdims=True) < 0
    return count, np.where(flipped, -samples.normals, samples.normals)


def _at_centres(samples: Samples, camera: Camera, image: PosedImage) -> Float64:
    """(N,) the depth of the samples' planes at the centres of their pixels.

    A slanted surface has another depth there than at the sample; a layer behind it has not.
    """
    pixels, depth, _ = project(samples.points, camera, image.world_to_camera)
    centres = (np.floor(pixels) + 0.5 - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rays = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    rotation = image.world_to_camera[:3, :3]
    normals = samples.normals @ rotation.T
    away = ((samples.points - image.centre) @ rotation.T * normals).sum(axis=1)
    found = away / (rays * normals).sum(axis=1)
    farthest = FARTHEST * depth / camera.fx
    return np.asarray(np.clip(found, depth - farthest, depth + farthest))


def nearest(
    points: Float64, triangles: Triangles, looked_up: Samples
) -> tuple[Float64, NDArray[np.int64]]:
    """Distances of points (N, 3) to a surface, and the rows of the nearest triangles.

    The candidates are the triangles of the nearest samples; the distance to them is exact.
    """
    near = cKDTree(looked_up.points).query(points, k=NEAREST)[1]
    best, rows = np.full(len(points), np.inf), np.zeros(len(points), np.int64)
    for k in range(NEAREST):
        faces = looked_up.faces[near[:, k]]
        found = np.linalg.norm(points - closest(points, triangles[faces].astype(float)), axis=1)
        better = found < best
        best[better], rows[better] = found[better], faces[better]
    return best, rows


def closest(points: Float64, triangles: Float64) -> Float64:
    """The nearest point of each of (N, 3, 3) triangles to one of (N, 3) points.

    The projection to the plane if it is inside, else the nearest point of the three edges.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    squared = np.maximum((normal**2).sum(axis=1, keepdims=True), 1e-30)
    flat = points - normal * ((points - a) * normal).sum(axis=1, keepdims=True) / squared
    inside = np.ones(len(points), dtype=bool)
    best, least = flat, np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= (np.cross(edge, flat - start) * normal).sum(axis=1) >= 0
        length = np.maximum((edge**2).sum(axis=1), 1e-30)
        t = np.clip(((points - start) * edge).sum(axis=1) / length, 0, 1)
        there = start + t[:, None] * edge
        distance = ((points - there) ** 2).sum(axis=1)
        nearer = distance < least
        best = np.where(nearer[:, None], there, best)
        least = np.minimum(distance, least)
    return np.where(inside[:, None], flat, best)


def aligned(made: Triangles, true: Triangles) -> Triangles:
    """A surface moved rigidly onto the true one (Chen and Medioni 1992, point to plane).

    Cameras from photos are not the true ones; what they are off as a whole is left out so.
    """
    looked_up, bottom = sampled(true, 5 * SAMPLES), float(true[..., 2].min()) + CONTACT
    own = sampled(made, SAMPLES // 10, seed=2)
    points = own.points[own.points[:, 2] > bottom]
    tree, moved, middle = cKDTree(looked_up.points), points, points.mean(axis=0)
    for _ in range(ROUNDS):
        away, rows = tree.query(moved, distance_upper_bound=WITHIN[-1])
        used = away < WITHIN[-1]
        normals, there = looked_up.normals[rows[used]], looked_up.points[rows[used]]
        off = ((moved[used] - there) * normals).sum(axis=1)
        slopes = np.concatenate([np.cross(moved[used] - middle, normals), normals], axis=1)
        turn, shift = np.split(np.linalg.lstsq(slopes, -off, rcond=None)[0], 2)
        rotation = Rotation.from_rotvec(turn).as_matrix()
        moved = (moved - middle) @ rotation.T + middle + shift
    start, end = points - points.mean(axis=0), moved - moved.mean(axis=0)
    rotation = Rotation.align_vectors(end, start)[0].as_matrix()
    turned: Float64 = (made.astype(float) - points.mean(axis=0)) @ rotation.T
    return np.asarray(turned + moved.mean(axis=0), dtype=np.float32)


def seen_truth(
    true: Triangles, rest: Triangles, images: Sequence[PosedImage], folder: Path
) -> tuple[Samples, float]:
    """Points of the true surface that two photos see, their normals outwards; and their share.

    What is within `CONTACT` of the object's bottom is left out.

    Args:
        true: triangles of the object.
        rest: what else can hide it.
        images: the photos.
        folder: where the result is kept.
    """
    digest = hashlib.sha256(f"{SLACK} {SLACK_PIXELS} {FARTHEST}".encode())
    digest.update(true.tobytes() + rest.tobytes())
    for image in images:
        digest.update(f"{image.name} {image.camera}".encode() + image.world_to_camera.tobytes())
    file = folder / f"seen-{digest.hexdigest()[:16]}.npz"
    if not file.exists():
        truth = sampled(true, SAMPLES, seed=1)
        truth = truth.rows(truth.points[:, 2] > float(true[..., 2].min()) + CONTACT)
        count, normals = views_of(truth, np.concatenate([true, rest]), images)
        seen = count >= LEAST_VIEWS
        kept = {"points": truth.points[seen], "normals": normals[seen], "faces": truth.faces[seen]}
        np.savez(file, **kept, share=seen.mean())
    with np.load(file) as arrays:
        samples = Samples(**{name: arrays[name] for name in ("points", "normals", "faces")})
        return samples, float(arrays["share"])


def compare(made: Triangles, true: Triangles, truth: Samples, seen: float) -> Scores:
    """Scores of a surface; see `Scores`.

    Args:
        made: (T, 3, 3) triangles with normals outwards.
        true: those of the object. What is within `CONTACT` of its bottom is left out.
        truth, seen: of `seen_truth`.
    """
    bottom = float(true[..., 2].min()) + CONTACT
    looked_up = sampled(true, 5 * SAMPLES)
    ours, ours_looked_up = sampled(made, SAMPLES, seed=2), sampled(made, 5 * SAMPLES, seed=3)
    ours = ours.rows(ours.points[:, 2] > bottom)
    off = nearest(ours.points, true, looked_up)[0]
    missed, faces = nearest(truth.points, made, ours_looked_up)
    a, b, c = made[faces].astype(float).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    cosine = (normals * truth.normals).sum(axis=1)[missed < WITHIN[-1]]
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    precision = tuple(float((off < d).mean()) for d in WITHIN)
    recall = tuple(float((missed < d).mean()) for d in WITHIN)
    both = zip(precision, recall, strict=True)
    return Scores(
        precision=precision,
        recall=recall,
        f=tuple(2 * p * r / max(p + r, 1e-9) for p, r in both),
        off=_middle_and_end(off),
        missed=_middle_and_end(missed),
        normals=float(np.median(angles)) if len(angles) else float("nan"),
        seen=seen,
    )


def _middle_and_end(values: Float64) -> tuple[float, float]:
    if not len(values):
        return float("nan"), float("nan")
    middle, end = np.percentile(values, (50, 95))
    return float(middle), float(end)
