# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of the demo's photos: wide ones round the room, close ones per object.

Each wish for a place is moved a little until rays cast into the scene say that the camera stands
free: not inside furniture, nothing right in front of the lens, the object not hidden.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

Bounds = dict[str, tuple[list[float], list[float]]]


@dataclass(frozen=True)
class Shot:
    """A photo: file name below the image folder, the camera's place, and its target."""

    name: str
    eye: Vector
    target: Vector

    def matrix(self) -> Matrix:
        """Camera to world with Blender's axes: the camera looks along its -Z."""
        look = (self.target - self.eye).to_track_quat("-Z", "Y")
        return Matrix.Translation(self.eye) @ look.to_matrix().to_4x4()


class Probe:
    """Casts rays into the scene to check whether there is free space around a camera."""

    def __init__(self, fov: tuple[float, float]) -> None:
        bpy.context.view_layer.update()
        self.graph = bpy.context.evaluated_depsgraph_get()
        self.slope = (math.tan(fov[0] / 2), math.tan(fov[1] / 2))
        k = np.arange(80) + 0.5
        phi, z = k * math.pi * (1 + 5**0.5), 1 - 2 * k / 80
        ring = np.sqrt(1 - z * z)
        self.sphere = [Vector(v) for v in np.stack([ring * np.cos(phi), ring * np.sin(phi), z], -1)]

    def cast(self, eye: Vector, way: Vector) -> tuple[float, bool, str]:
        """Distance of the first hit, whether it is a back face, and the boxed object hit."""
        hit, spot, normal, _, obj, _ = bpy.context.scene.ray_cast(self.graph, eye, way)
        if not hit:
            return math.inf, False, ""
        return (spot - eye).length, normal.dot(way) > 0, obj.get("roi", "")

    def free(self, shot: Shot, front: float) -> bool:
        """Whether the camera has space around it, and its picture nothing nearer than `front`."""
        around = [self.cast(shot.eye, way) for way in self.sphere]
        if min(d for d, _, _ in around) < 0.1 or sum(back for _, back, _ in around) > 12:
            return False
        turn = shot.matrix().to_3x3()
        for x in np.linspace(-1, 1, 9):
            for y in np.linspace(-1, 1, 7):
                way = turn @ Vector((x * self.slope[0], y * self.slope[1], -1)).normalized()
                if self.cast(shot.eye, way)[0] < front:
                    return False
        return True

    def hidden(self, shot: Shot, low: Vector, high: Vector, roi: str) -> float:
        """The share of rays to the object's box that something else blocks."""
        rng = np.random.default_rng(5)
        blocked = 0
        for part in rng.uniform(0.12, 0.88, (60, 3)):
            spot = Vector([a + (b - a) * p for a, b, p in zip(low, high, part, strict=True)])
            way = spot - shot.eye
            distance, _, hit = self.cast(shot.eye, way.normalized())
            blocked += distance < way.length and hit != roi
        return blocked / 60


def wide_wishes(rng: np.random.Generator) -> Iterator[tuple[float, float, float, Vector]]:
    """Angle, ring size, height and target of the wide photos."""
    for k in range(22):
        a = 2 * math.pi * k / 22
        yield a, 1.0, 1.5 + rng.uniform(-0.1, 0.1), Vector((*rng.uniform(-0.25, 0.25, 2), 0.78))
    for k in range(18):
        a = 2 * math.pi * (k + 0.5) / 18
        far = 0.55 * Vector((-math.cos(a), -math.sin(a), 0)) + Vector((0, 0, 0.85))
        yield a, 0.9, 1.12 + rng.uniform(-0.06, 0.12), far + Vector((*rng.uniform(-0.2, 0.2, 2), 0))
    for k in range(8):
        a = 2 * math.pi * (k + 0.25) / 8
        yield a, 0.92, 1.95, Vector((*rng.uniform(-0.2, 0.2, 2), 0.6))
    for k in range(12):
        a = 2 * math.pi * (k + 0.4) / 12
        b = a + math.pi + (0.5 if k % 2 else -0.5)
        yield a, 0.85, 1.45 + 0.15 * (k % 3), Vector((2.6 * math.cos(b), 2.2 * math.sin(b), 1.1))


def wide_shots(probe: Probe, seed: int = 7) -> list[Shot]:
    """Photos of a walk round the room: rings at several heights, most looking at the middle."""
    rng = np.random.default_rng(seed)
    shots = []
    for k, (a, ring, height, target) in enumerate(wide_wishes(rng)):
        c, s = math.cos(a), math.sin(a)
        corner = (abs(c) ** 3 + abs(s) ** 3) ** (-1 / 3)
        for shrink in (1.0, 0.94, 0.88, 0.82, 0.76, 0.7):
            grow = ring * corner * shrink
            eye = Vector((1.95 * c * grow, 1.6 * s * grow, height + 0.5 * (1 - shrink)))
            shot = Shot(f"wide/wide_{k:03d}.jpg", eye, target)
            if probe.free(shot, 0.5):
                shots.append(shot)
                break
        else:
            print(f"no free place for wide photo {k}")
    return shots


def close_shots(
    probe: Probe, name: str, bounds: Bounds, count: int, half: bool = False
) -> list[Shot]:
    """Photos around an object: near ones at several heights, every third from farther away.

    With `half`, the object stands at a wall, and only its front, to the north, is photographed.
    """
    low, high = (Vector(v) for v in bounds[name])
    middle, size = (low + high) / 2, (high - low).length
    shots = []
    for k in range(count):
        share = (k + 0.5) / count
        turn = math.pi * (0.08 + 0.84 * share) if half else 2 * math.pi * share + 0.2
        rise = math.radians((10, 30, 18, 46, 24)[k % 5])
        reach = size * (1.12, 1.32, 2.3)[k % 3]
        for extra in np.radians((0, 6, -6, 12, 18, 26, 34)):
            up = rise + extra
            way = Vector(
                (math.cos(turn) * math.cos(up), math.sin(turn) * math.cos(up), math.sin(up))
            )
            shot = Shot(f"close/{name}_{k:02d}.jpg", middle + reach * way, middle)
            if probe.hidden(shot, low, high, name) < 0.06 and probe.free(shot, 0.17):
                shots.append(shot)
                break
        else:
            print(f"no free place for close photo {k} of {name}")
    return shots


def table_shots(probe: Probe, count: int = 250, seed: int = 11) -> list[Shot]:
    """Close photos all around the table; in most of them, its top fills most of the picture."""
    rng = np.random.default_rng(seed)
    shots: list[Shot] = []
    for k in range(count):
        turn = 2 * math.pi * ((k * 0.618034) % 1)
        rise = math.radians((14, 24, 34, 46, 60)[k % 5] + rng.uniform(-4, 4))
        reach = (0.95, 1.1, 1.3)[k % 3] + rng.uniform(-0.08, 0.08)
        target = Vector((*rng.uniform(-0.12, 0.12, 2), 0.86))
        for extra in np.radians((0, 6, -6, 12, 18, 26)):
            up = rise + extra
            way = Vector(
                (math.cos(turn) * math.cos(up), 0.8 * math.sin(turn) * math.cos(up), math.sin(up))
            )
            shot = Shot(f"table/table_{k:03d}.jpg", target + reach * way, target)
            if probe.free(shot, 0.25):
                shots.append(shot)
                break
    return shots
