# SPDX-License-Identifier: GPL-3.0-or-later
"""The photos of a large capture of the demo's room: where a person takes them, and what goes wrong.

Five hundred photos of a day: walks along the walls, rings at three heights, many alike, close-ups.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from cameras import Bounds, Probe, Shot
from mathutils import Matrix, Vector
from measures import HALF_X, HALF_Y

STEPS, TURNS = 30, (72, 72, 60)
"""Number of photos along a wall; in each ring."""
HEIGHTS = (0.95, 1.45, 1.95)
STILLS, ALIKE = 20, 6
"""Number of places where a person takes several photos; photos at each."""
CLOSE = 24
SHRINKS = (1.0, 0.94, 0.88, 0.82, 0.76, 0.7)
BLURRED, FOREGROUND = 10, 12
"""One photo in this many is blurred by motion; one in this many is focused on the foreground."""
DRIFT = 0.12
"""Change of exposure from photo to photo, in stops (standard deviation)."""


@dataclass(frozen=True)
class Taken(Shot):
    """A photo as a person takes it.

    `roll` is the tilt in radians. While the shutter is open, the camera moves by `slide` and turns
    by `swing` (radians about its x and y axes). `focus` is a distance in metres, or None if all is
    sharp. `stops` is the exposure relative to the capture's.
    """

    roll: float = 0.0
    slide: tuple[float, float, float] = (0.0, 0.0, 0.0)
    swing: tuple[float, float] = (0.0, 0.0)
    focus: float | None = None
    stops: float = 0.0

    def matrix(self) -> Matrix:
        """Camera to world in the middle of the exposure, with Blender's axes."""
        return super().matrix() @ Matrix.Rotation(self.roll, 4, "Z")

    def moved(self, part: float) -> Matrix:
        """Camera to world at a moment of the exposure, -0.5 to 0.5."""
        turn = Matrix.Rotation(self.swing[0] * part, 4, "X")
        turn = turn @ Matrix.Rotation(self.swing[1] * part, 4, "Y")
        return Matrix.Translation(part * Vector(self.slide)) @ self.matrix() @ turn

    @property
    def plain(self) -> bool:
        """Whether the photo has no faults, apart from its exposure."""
        return self.focus is None and not any((*self.slide, *self.swing))


def large_capture(probe: Probe, bounds: Bounds, seed: int = 23) -> list[Taken]:
    """About 500 photos, in the order in which they were taken."""
    rng = np.random.default_rng(seed)
    shots = [*_walks(probe, rng), *_rings(probe, rng)]
    shots += _alike(shots, rng)
    for name in bounds:
        shots += _close(probe, rng, name, bounds, CLOSE, half=name == "clock")
    shots = [replace(shot, roll=rng.normal(0, math.radians(2.5))) for shot in shots]
    stops = _drift(rng, len(shots))
    return [
        replace(_spoilt(shot, rng, number), stops=float(stop))
        for number, (shot, stop) in enumerate(zip(shots, stops, strict=True))
    ]


def held_out(probe: Probe, bounds: Bounds, seed: int = 29) -> list[Taken]:
    """Faultless views of the room and of each object that are in no photo of the capture."""
    rng = np.random.default_rng(seed)
    shots = _rings(probe, rng, (8, 8, 8), turned=0.37)
    for name in bounds:
        shots += _close(probe, rng, name, bounds, 12, half=name == "clock")
    return [replace(shot, name=f"held_out/{shot.name}") for shot in shots]


def _spoilt(shot: Taken, rng: np.random.Generator, number: int) -> Taken:
    """Make some photos blurred, and some focused on the foreground."""
    slide, swing = rng.normal(0, 0.004, 3), rng.normal(0, math.radians(0.35), 2)
    focus = rng.uniform(0.35, 0.6) * (shot.target - shot.eye).length
    if number % BLURRED == BLURRED // 2:
        return replace(shot, slide=tuple(slide.tolist()), swing=tuple(swing.tolist()))
    return replace(shot, focus=float(focus)) if number % FOREGROUND == 3 else shot


def _drift(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count,) stops within +-1.5, as a camera's automatic exposure drifts."""
    stops, now = [], 0.0
    for step in rng.normal(0, DRIFT, count):
        now += step
        if abs(now) > 1.5:  # reflected at the limit
            now = math.copysign(3.0 - abs(now), now)
        stops.append(now)
    return np.array(stops)


def _walks(probe: Probe, rng: np.random.Generator) -> list[Taken]:
    """Photos along each wall, half a metre from it, with the other side of the room in view."""
    shots = []
    for wall in range(4):
        for k in range(STEPS):
            along, height = -0.8 + 1.6 * k / (STEPS - 1), 1.5 + rng.uniform(-0.08, 0.08)
            aim = Vector((*rng.uniform(-0.5, 0.5, 2), rng.uniform(0.7, 1.0)))
            for near in SHRINKS:
                away = (HALF_X, HALF_Y)[wall % 2] - 0.5 - (1 - near)
                side = (1, 1, -1, -1)[wall] * away
                flat = (side, along * HALF_Y) if wall % 2 == 0 else (along * HALF_X, side)
                shot = Taken(f"walk/{wall}_{k:02d}.jpg", Vector((*flat, height)), aim)
                if probe.free(shot, 0.4):
                    shots.append(shot)
                    break
    return shots


def _rings(
    probe: Probe, rng: np.random.Generator, turns: tuple[int, ...] = TURNS, turned: float = 0.0
) -> list[Taken]:
    """Photos around the table at several heights, most with its middle in view."""
    shots = []
    for ring, (count, height) in enumerate(zip(turns, HEIGHTS, strict=True)):
        for k in range(count):
            turn = 2 * math.pi * (k + turned) / count
            c, s = math.cos(turn), math.sin(turn)
            corner = (abs(c) ** 3 + abs(s) ** 3) ** (-1 / 3)
            aim = Vector((*rng.uniform(-0.3, 0.3, 2), 0.8 + 0.1 * (1 - ring)))
            for near in SHRINKS:
                reach = corner * near
                eye = Vector((1.9 * c * reach, 1.55 * s * reach, height + rng.uniform(-0.05, 0.05)))
                shot = Taken(f"ring/{ring}_{k:02d}.jpg", eye, aim)
                if probe.free(shot, 0.4):
                    shots.append(shot)
                    break
    return shots


def _alike(shots: list[Taken], rng: np.random.Generator) -> Iterator[Taken]:
    """More photos from nearly the same places."""
    chosen = rng.permutation(len(shots))[:STILLS]
    for place, number in enumerate(chosen):
        for k in range(ALIKE):
            eye = shots[number].eye + Vector(rng.normal(0, 0.012, 3).tolist())
            aim = shots[number].target + Vector(rng.normal(0, 0.03, 3).tolist())
            yield Taken(f"still/{place:02d}_{k}.jpg", eye, aim)


def _close(
    probe: Probe, rng: np.random.Generator, name: str, bounds: Bounds, count: int, *, half: bool
) -> list[Taken]:
    """Close-ups of an object, from 1.1 to 2.6 of its diagonals; `half`: it stands at a wall."""
    low, high = (Vector(corner) for corner in bounds[name])
    middle, size = (low + high) / 2, (high - low).length
    shots = []
    for k in range(count):
        share = (k + rng.uniform()) / count
        turn = math.pi * (0.08 + 0.84 * share) if half else 2 * math.pi * share
        reach = size * (1.1, 1.35, 1.8, 2.6)[k % 4]
        for rise in np.radians(rng.uniform(8, 42) + np.array((0, 6, -6, 12, 20, 28))):
            flat = math.cos(rise)
            way = Vector((math.cos(turn) * flat, math.sin(turn) * flat, math.sin(rise)))
            aim = middle + Vector(rng.normal(0, 0.05 * size, 3).tolist())
            shot = Taken(f"close/{name}_{k:02d}.jpg", middle + reach * way, aim)
            if probe.hidden(shot, low, high, name) < 0.1 and probe.free(shot, 0.15):
                shots.append(shot)
                break
    return shots
