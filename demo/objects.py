# SPDX-License-Identifier: GPL-3.0-or-later
"""The three objects that get a box: a carved vase, a printed tin and a carved clock.

Every part carries the custom property `roi`; the bounds of an object are those of its parts.
"""

from __future__ import annotations

import bpy
import numpy as np
from build import place
from clock import clock
from materials import Library
from mathutils import Matrix, Vector
from measures import SIDEBOARD, TABLE_TOP
from tin import tin
from vase import vase


def build_objects(lib: Library) -> None:
    """All objects that get a box."""
    vase(place((-0.44, 0.06, TABLE_TOP + 0.003)) @ Matrix.Scale(0.86, 4))
    tin(lib, place((0.44, -0.03, TABLE_TOP + 0.003), (0, 0, 24)))
    x, y = SIDEBOARD["centre"]
    spot = place((x, y + 0.05, SIDEBOARD["top"] + 0.003), (0, 0, 180))
    clock(lib, spot @ Matrix.Scale(0.82, 4))


def move_things() -> None:
    """Move things that people might move between photos: chairs, a newspaper, a bowl of fruit."""
    moves = {"0": (0.22, 0.1, 0.0), "1": (-0.18, 0.16, 0.0)}
    for obj in bpy.context.scene.objects:
        kind, _, rest = obj.name.partition(" ")
        part = rest.split()[-1][:1] if rest else ""
        if kind in ("seat", "chair") and part in moves:
            obj.location = obj.location + Vector(moves[part])
        elif obj.name == "newspaper":
            obj.location = obj.location + Vector((-0.12, 0.05, 0.0))
        elif obj.name == "bowl" or kind == "fruit":
            obj.location = obj.location + Vector((0.1, -0.04, 0.0))
    bpy.context.view_layer.update()


def bounds() -> dict[str, tuple[list[float], list[float]]]:
    """World bounds (min, max) of every boxed object, from the points of its parts."""
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    found: dict[str, list[np.ndarray]] = {}
    for obj in bpy.context.scene.objects:
        if "roi" not in obj:
            continue
        mesh = obj.evaluated_get(graph).data
        points = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", points)
        matrix = np.array(obj.matrix_world)
        world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        found.setdefault(obj["roi"], []).extend((world.min(0), world.max(0)))
    return {
        name: (np.min(spots, 0).tolist(), np.max(spots, 0).tolist())
        for name, spots in found.items()
    }
