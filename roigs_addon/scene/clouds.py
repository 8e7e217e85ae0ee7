"""Points with attributes as Blender objects, for every render engine.

Before Blender 5.1, Python cannot resize point clouds. So the points are vertices of a mesh, and a
geometry-nodes modifier turns them into points, with a radius and a material.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import mesh_of
from . import textured_meshes

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import AttributeTypeItems

COLOUR = "Color"
"""Attribute with the points' colours, linear light."""

POINTS = "Points"
"""Name of the modifier that shows vertices as points."""

ATTRIBUTE_KEYS = {
    "FLOAT": "value",
    "FLOAT_VECTOR": "vector",
    "FLOAT_COLOR": "color",
    "FLOAT4": "vector",
    "BYTE_COLOR": "color",
    "QUATERNION": "value",
}


def new_points(name: str, positions: NDArray[np.float32]) -> bpy.types.Object:
    """A mesh object of vertices at `positions` (N, 3), not linked to any collection yet."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).ravel())
    return bpy.data.objects.new(name, mesh)


def set_attribute(
    mesh: bpy.types.Mesh, name: str, kind: AttributeTypeItems, values: NDArray[np.float32]
) -> None:
    """Give the vertices an attribute; `values` has a row per vertex."""
    attribute: Any = mesh.attributes.new(name, kind, "POINT")
    flat = np.ascontiguousarray(values, np.float32).ravel()
    attribute.data.foreach_set(ATTRIBUTE_KEYS[kind], flat)


def positions(item: bpy.types.Object) -> NDArray[np.float32]:
    """(N, 3) of the vertices, in the object's own frame."""
    return positions_of(mesh_of(item))


def positions_of(mesh: bpy.types.Mesh) -> NDArray[np.float32]:
    """(N, 3) of a mesh's vertices."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def show_as_points(
    item: bpy.types.Object, material: bpy.types.Material, radius: float | str
) -> None:
    """Add the modifier that shows points. `radius` is a number or the name of an attribute."""
    group = _points_group(f"{item.name} points", material, radius)
    add_nodes_modifier(item, POINTS, group)


def shown_radius(item: bpy.types.Object) -> float | None:
    """Radius of an object's points in its own frame, as `show_as_points` set it.

    None if the viewport shows no points, because the modifier is off or gone.
    """
    modifier = item.modifiers.get(POINTS)
    group: Any = getattr(modifier, "node_group", None)
    if modifier is None or group is None or not modifier.show_viewport:
        return None
    made = (n for n in group.nodes if n.bl_idname == "GeometryNodeMeshToPoints")
    return next((float(node.inputs["Radius"].default_value) for node in made), None)


def geometry_group(name: str) -> Any:
    """A new geometry-nodes group for a modifier; its nodes are of types that the stubs lack."""
    group: Any = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.is_modifier = True
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    return group


def add_nodes_modifier(item: bpy.types.Object, name: str, group: bpy.types.NodeTree | None) -> None:
    """Add a modifier with a geometry-nodes group to an object.

    It is off in edit mode: with it, Blender 5.2 does not show which points are selected.
    """
    modifier = item.modifiers.new(name, "NODES")
    assert isinstance(modifier, bpy.types.NodesModifier)
    modifier.node_group = group
    modifier.show_in_editmode = False


def _points_group(name: str, material: bpy.types.Material, radius: float | str) -> Any:
    group = geometry_group(name)
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    to_points = group.nodes.new("GeometryNodeMeshToPoints")
    set_material = group.nodes.new("GeometryNodeSetMaterial")
    set_material.inputs["Material"].default_value = material
    link = group.links.new
    if isinstance(radius, str):
        attribute = group.nodes.new("GeometryNodeInputNamedAttribute")
        attribute.data_type = "FLOAT"
        attribute.inputs["Name"].default_value = radius
        value = next(s for s in attribute.outputs if s.enabled and s.name == "Attribute")
        link(value, to_points.inputs["Radius"])
    else:
        to_points.inputs["Radius"].default_value = radius
    link(start.outputs[0], to_points.inputs[0])
    link(to_points.outputs[0], set_material.inputs["Geometry"])
    link(set_material.outputs[0], end.inputs[0])
    for x, node in enumerate((start, to_points, set_material, end)):
        node.location.x = 200 * x
    return group


def colour_material(name: str, opacity: str = "") -> bpy.types.Material:
    """A material that shows the attribute `Color` unlit, with the transparency of `opacity`.

    Args:
        name: of the material.
        opacity: name of an attribute from 0 to 1; empty: opaque.
    """
    material = textured_meshes.blank_material(name)
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    colour = nodes.new("ShaderNodeAttribute")
    colour.attribute_name = COLOUR
    light = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    link(colour.outputs["Color"], light.inputs["Color"])
    if opacity:
        share = nodes.new("ShaderNodeAttribute")
        share.attribute_name = opacity
        clear = nodes.new("ShaderNodeBsdfTransparent")
        mix = nodes.new("ShaderNodeMixShader")
        link(share.outputs["Fac"], mix.inputs[0])
        link(clear.outputs[0], mix.inputs[1])
        link(light.outputs[0], mix.inputs[2])
        link(mix.outputs[0], output.inputs["Surface"])
    else:
        link(light.outputs[0], output.inputs["Surface"])
    shown: bpy.types.Material = material
    return shown


def to_linear(srgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """sRGB values in 0..1 as scene-linear values, as colour attributes store them."""
    low = srgb / 12.92
    high = ((np.maximum(srgb, 0) + 0.055) / 1.055) ** 2.4
    return np.where(srgb <= 0.04045, low, high).astype(np.float32)
