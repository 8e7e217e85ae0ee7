# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the true surfaces of the demo's objects, to measure `benchmarks.surface` with.

Builds the room as `make_scene.py` does. Writes a file of NumPy (npz) with the triangles (T, 3, 3)
of each boxed object by its name, and of `rest of the room`, in the frame of the COLMAP model: z up,
metres. Needs `pip install bpy==4.5.15`.

    python demo/meshes.py meshes.npz
"""

from __future__ import annotations

import argparse
from pathlib import Path

import bpy
import numpy as np
import objects
import room
from make_scene import prepare
from materials import Library

REST = "rest of the room"


def triangles(thing: bpy.types.Object, graph: bpy.types.Depsgraph) -> np.ndarray:
    """An object's triangles (T, 3, 3) in the world, with its modifiers applied."""
    mesh = thing.evaluated_get(graph).to_mesh()
    mesh.calc_loop_triangles()
    points = np.empty(len(mesh.vertices) * 3, np.float32)
    corners = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.vertices.foreach_get("co", points)
    mesh.loop_triangles.foreach_get("vertices", corners)
    matrix = np.array(thing.matrix_world)
    world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return world[corners].reshape(-1, 3, 3).astype(np.float32)


def main() -> None:
    """Build the room and write its triangles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="file to write, .npz")
    out = parser.parse_args().out
    prepare(1, 80, 0)
    lib = Library()
    room.build_room(lib)
    objects.build_objects(lib)
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    found: dict[str, list[np.ndarray]] = {}
    for thing in bpy.context.scene.objects:
        if thing.type in ("MESH", "CURVE", "FONT"):
            found.setdefault(thing.get("roi", REST), []).append(triangles(thing, graph))
    np.savez(out, **{name: np.concatenate(parts) for name, parts in found.items()})


if __name__ == "__main__":
    main()
