# SPDX-License-Identifier: GPL-3.0-or-later
"""The five things that the demo's capture never saw; made in Blender, in the demo's metres.

Four stand on the table together, without touching each other or what is there: a grey ball, a
mirror ball, a glass and a white monkey. The fifth is a lamp beside the vase.
"""

from __future__ import annotations

from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

TABLE = 0.76
"""Height of the table's top."""
PLACES = {
    "grey ball": (-0.25, -0.32),
    "mirror ball": (0.3, -0.31),
    "glass": (0.26, 0.3),
    "monkey": (-0.36, 0.31),
}
"""Names, in the order of their indices from 1, and where on the table they stand."""
LAMP = (-0.66, -0.2, 1.02)
"""Centre of the lamp's bulb: 0.34 from the vase's axis, at the height of its upper part."""
LAMP_POWER, LAMP_COLOUR, LAMP_RADIUS = 4.0, (1.0, 0.62, 0.3), 0.03

GLASS = (
    (0.0005, 0.0),
    (0.033, 0.0),
    (0.038, 0.125),
    (0.0358, 0.125),
    (0.0312, 0.012),
    (0.0005, 0.009),
)
"""Radius and height of a tumbler's outside, then its inside."""


SIZE = 0.085
"""Of the monkey: its head is 2.7 times as wide."""


def put_things() -> dict[str, Any]:
    """Make the four things on the table in the current scene; returns objects by name."""
    made = {
        "grey ball": _ball("grey ball", 0.07, _matt("grey ball", 0.2)),
        "mirror ball": _ball("mirror ball", 0.08, _mirror()),
        "glass": _turned("glass", GLASS, _glass()),
        "monkey": _monkey(),
    }
    for number, (name, (x, y)) in enumerate(PLACES.items(), 1):
        thing = made[name]
        lowest = min((thing.matrix_basis @ vertex.co).z for vertex in thing.data.vertices)
        thing.location = (x, y, TABLE - lowest)
        thing.pass_index = number
    context: Any = bpy.context
    context.view_layer.update()
    return made


def put_lamp() -> Any:
    """Make the lamp in the current scene: a round bulb that cameras see."""
    data: Any = bpy.data.lights.new("lamp", "POINT")
    data.energy, data.color, data.shadow_soft_size = LAMP_POWER, LAMP_COLOUR, LAMP_RADIUS
    lamp = _linked("lamp", data)
    lamp.location = LAMP
    return lamp


def _linked(name: str, data: Any) -> Any:
    thing: Any = bpy.data.objects.new(name, data)
    scene: Any = bpy.context.scene
    scene.collection.objects.link(thing)
    return thing


def _ball(name: str, radius: float, material: Any) -> Any:
    steps = np.linspace(-np.pi / 2, np.pi / 2, 49)
    profile = [(max(radius * np.cos(a), 1e-5), radius * np.sin(a)) for a in steps]
    return _turned(name, profile, material)


def _turned(name: str, profile: Any, material: Any, segments: int = 96) -> Any:
    """A smooth body turned about z from (radius, height) pairs, its normals outwards."""
    radius, height = np.asarray(profile, float).T
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    rings = [radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)]
    points = np.stack([*rings, np.repeat(height[:, None], segments, 1)], -1).reshape(-1, 3)
    i, j = np.mgrid[0 : len(radius) - 1, 0:segments]
    a, b = i * segments + j, i * segments + (j + 1) % segments
    faces = np.stack([a, b, b + segments, a + segments], -1).reshape(-1, 4)
    mesh: Any = bpy.data.meshes.new(name)
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    if name == "glass":  # its foot and rim are edges
        mesh.set_sharp_from_angle(angle=0.6)
    mesh.materials.append(material)
    return _linked(name, mesh)


def _monkey() -> Any:
    """Suzanne, twice subdivided, on her chin."""
    form = bmesh.new()
    bmesh.ops.create_monkey(form, matrix=Matrix.Scale(SIZE, 4))
    mesh: Any = bpy.data.meshes.new("monkey")
    form.to_mesh(mesh)
    form.free()
    thing = _linked("monkey", mesh)
    thing.rotation_euler = (-0.6, 0.0, 2.5)
    thing.modifiers.new("smooth", "SUBSURF").levels = 2
    graph = bpy.context.evaluated_depsgraph_get()
    thing.data = bpy.data.meshes.new_from_object(thing.evaluated_get(graph))
    thing.modifiers.clear()
    thing.data.shade_smooth()
    thing.data.materials.append(_matt("monkey", 0.5))
    return thing


def _material(name: str) -> tuple[Any, Any, Any]:
    """A material's nodes and links, and its output's socket."""
    material: Any = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    return material, nodes, nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]


def _matt(name: str, grey: float) -> Any:
    """A matt material that reflects a share of the light."""
    material, nodes, out = _material(name)
    shader = nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (grey, grey, grey, 1.0)
    material.node_tree.links.new(shader.outputs[0], out)
    return material


def _mirror() -> Any:
    material, nodes, out = _material("mirror ball")
    shader = nodes.new("ShaderNodeBsdfGlossy")
    shader.inputs["Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    shader.inputs["Roughness"].default_value = 0.0
    material.node_tree.links.new(shader.outputs[0], out)
    return material


def _glass() -> Any:
    """Clear glass that lets most light through to its shadow, without caustics."""
    material, nodes, out = _material("glass")
    links = material.node_tree.links
    glass, clear = nodes.new("ShaderNodeBsdfGlass"), nodes.new("ShaderNodeBsdfTransparent")
    glass.inputs["IOR"].default_value = 1.5
    clear.inputs["Color"].default_value = (0.85, 0.85, 0.85, 1.0)
    path, mix = nodes.new("ShaderNodeLightPath"), nodes.new("ShaderNodeMixShader")
    links.new(path.outputs["Is Shadow Ray"], mix.inputs["Fac"])
    links.new(glass.outputs[0], mix.inputs[1])
    links.new(clear.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], out)
    return material
