"""Decides how an object's Gaussians are shown: Blender's own splats, by the add-on, or as points.

In each display, an object is the same mesh of points with attributes, so all edits of these work.
From Blender 5.3 on, a modifier converts them to Blender's own splats. Before, and for the exact
look, a modifier hides the points, and the add-on draws the Gaussians of the object's file.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import bpy
import numpy as np

from ..blender import is_local
from ..geometry.splat_cloud import SH_C0
from ..properties import object_props
from . import clouds, edits, instances, lookup, native_splats
from .node_groups import known_group
from .splat_attributes import SH_NAMES

MODIFIER = "Drawn as Gaussians"
NOTHING = MODIFIER
"""Name of the group without any geometry."""
SPLATS = "Blender's Splats"
"""Name of the node group that makes Blender's own splats."""
EXPOSURE, TINT = "Exposure", "Tint"
"""Inputs of that group; drivers give them the object's look."""
INPUTS = f'modifiers["{MODIFIER}"].properties.inputs'
BASE = "radiance:base"
APPLIED = ("Applied X", "Applied Y", "Applied Z")
"""Inputs of that group: columns of the (3, 3) map of all points by **Object ▸ Apply**."""
TREE = "GeometryNodeTree"
GEOMETRY = (("Geometry", "INPUT", "Geometry"), ("Geometry", "OUTPUT", "Geometry"))
SOCKETS = (
    *GEOMETRY,
    (EXPOSURE, "INPUT", "Float"),
    *((name, "INPUT", "Vector") for name in (TINT, *APPLIED)),
)


def is_native(item: bpy.types.Object, *, viewport: bool = False) -> bool:
    """Whether Blender shows an object as its own splats, in renders or in the viewport.

    In edit mode, Blender shows only points. So the add-on draws such objects in the viewport.
    """
    if viewport and item.mode == "EDIT":
        return False
    return bool(object_props(item).shown_as == "GAUSSIANS") and native_splats.exist()


def in_layer(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The Gaussians of a scene that the engine draws in renders."""
    found = (*lookup.splats(scene), *instances.in_collections(scene))
    return [item for item in found if instances.is_drawn(item) and not is_native(item)]


def show_as(item: bpy.types.Object, way: str) -> None:
    """Show an object in one of the ways of `properties.SHOWN_AS`, unless another .blend has it."""
    if is_local(item):
        object_props(item).shown_as = way
        object_props(item).property_unset("exact_for")
        refresh(item)


def show_exactly(item: bpy.types.Object, what: str) -> None:
    """Show Blender's own splats in the exact look as long as something is there; others stay."""
    if is_native(item) and is_local(item):
        show_as(item, "EXACT")
        object_props(item).exact_for = what


def show_again(items: Iterable[bpy.types.Object], what: str) -> None:
    """Show Blender's own splats again, as that is gone."""
    for item in items:
        if object_props(item).exact_for == what:
            show_as(item, "GAUSSIANS")


def refresh(item: bpy.types.Object) -> None:
    """Set an object's modifiers for its display: another Blender may have saved the file."""
    points, hide = (item.modifiers.get(name) for name in (clouds.POINTS, MODIFIER))
    if not isinstance(hide, bpy.types.NodesModifier) or not is_local(item):
        return
    native = is_native(item)
    if points is not None:
        _switch(points, on=not native)
    _switch(hide, on=object_props(item).shown_as != "POINTS")
    group = _splats_group() if native else _nothing_group()
    if not native:
        _let_go(item)
    if hide.node_group != group:
        hide.node_group = group
    if native:
        _drive(item, hide)
        _apply(item, hide)


def follow(item: bpy.types.Object) -> None:
    """Give Blender's splats the map that all points of an object went through, as by Apply."""
    modifier = item.modifiers.get(MODIFIER)
    if isinstance(modifier, bpy.types.NodesModifier) and is_local(item) and is_native(item):
        _apply(item, modifier)


def _apply(item: bpy.types.Object, modifier: bpy.types.NodesModifier) -> None:
    frame = edits.drawn_frame(item)[:3, :3]
    wanted = np.eye(3) if np.allclose(frame, np.eye(3), atol=1e-4) else frame
    ids, properties = _inputs(modifier), modifier.properties  # type: ignore[attr-defined]
    for name, column in zip(APPLIED, wanted.T, strict=True):
        held = getattr(properties.inputs, ids[name])
        if not np.allclose(held.value, column, atol=1e-6):
            held.value = column.tolist()


def _switch(modifier: bpy.types.Modifier, *, on: bool) -> None:
    if modifier.show_viewport != on:
        modifier.show_viewport = on
    if modifier.show_render != on:
        modifier.show_render = on


def _drive(item: bpy.types.Object, modifier: bpy.types.NodesModifier) -> None:
    """Drive the group's inputs by the object's look, which may be animated."""
    ids = _inputs(modifier)
    drivers = item.animation_data.drivers if item.animation_data is not None else ()
    known = {(curve.data_path, curve.array_index) for curve in drivers}
    for name, index in ((EXPOSURE, 0), (TINT, 0), (TINT, 1), (TINT, 2)):
        path = f"{INPUTS}.{ids[name]}.value"
        if (path, index) in known:
            continue
        curve: Any = item.driver_add(path, *([index] if name == TINT else []))
        driver = curve.driver
        driver.type = "SUM"  # no script, so it also runs in untrusted files
        target = driver.variables.new().targets[0]
        target.id = item
        target.data_path = f"roigs.tint[{index}]" if name == TINT else "roigs.exposure"


def _inputs(modifier: bpy.types.NodesModifier) -> dict[str, str]:
    """The inputs of a modifier's group: name -> identifier."""
    group: Any = modifier.node_group
    return {s.name: s.identifier for s in group.interface.items_tree if s.in_out == "INPUT"}


def _let_go(item: bpy.types.Object) -> None:
    """Remove the drivers of the group's inputs. Without the group, Blender would warn of them."""
    if item.animation_data is not None:
        for curve in [c for c in item.animation_data.drivers if c.data_path.startswith(INPUTS)]:
            item.animation_data.drivers.remove(curve)


def _nothing_group() -> bpy.types.NodeTree:
    """A geometry-nodes group without any geometry."""
    if (known := known_group(NOTHING, TREE, GEOMETRY)) is not None:
        found: bpy.types.NodeTree = known
        return found
    group = clouds.geometry_group(NOTHING)
    group.nodes.new("NodeGroupOutput")
    made: bpy.types.NodeTree = group
    return made


def _splats_group() -> bpy.types.NodeTree:
    """Return the geometry-nodes group that turns points into Blender's splats, with a look.

    Colours are 0.5 + SH. To apply gains, all coefficients are multiplied, and the first one gets
    0.5 (gain - 1) / `SH_C0` more. Without gains no attribute is written, so Blender copies none.
    """
    if (known := known_group(SPLATS, TREE, SOCKETS)) is not None:
        found: bpy.types.NodeTree = known
        return found
    group = clouds.geometry_group(SPLATS)
    for name, kind in ((EXPOSURE, "NodeSocketFloat"), (TINT, "NodeSocketVector")):
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type=kind)
        socket.default_value = 0.0 if name == EXPOSURE else (1.0, 1.0, 1.0)
    for name, axis in zip(APPLIED, np.eye(3).tolist(), strict=True):
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketVector")
        socket.default_value = axis
    new, link = group.nodes.new, group.links.new
    start, end = new("NodeGroupInput"), new("NodeGroupOutput")
    points, splats = new("GeometryNodeMeshToPoints"), new("GeometryNodePointsSetType")
    splats.inputs["Type"].default_value = "3D Gaussian Splat"
    applied, back = _applied(group, start), new("FunctionNodeInvertMatrix")
    link(applied, back.inputs[0])
    link(_transformed(group, start.outputs[0], back.outputs[0]), points.inputs[0])
    link(points.outputs[0], splats.inputs[0])
    power = new("ShaderNodeMath")
    power.operation, power.inputs[0].default_value = "POWER", 2.0
    link(start.outputs[EXPOSURE], power.inputs[1])
    gains = _vector_math(group, "SCALE", start.outputs[TINT], scale=power.outputs[0])
    looks = splats.outputs[0]
    for name in SH_NAMES:
        read = _attribute(group, name, "FLOAT_VECTOR")
        seen = _vector_math(group, "MULTIPLY", read.outputs["Attribute"], gains)
        looks = _store(group, looks, name, "FLOAT_VECTOR", seen, read.outputs["Exists"])
    read = _attribute(group, BASE, "FLOAT_COLOR")
    parts, whole = new("FunctionNodeSeparateColor"), new("FunctionNodeCombineColor")
    link(read.outputs["Attribute"], parts.inputs[0])
    triple = new("ShaderNodeCombineXYZ")
    for k in range(3):
        link(parts.outputs[k], triple.inputs[k])
    scaled = _vector_math(group, "MULTIPLY", triple.outputs[0], gains)
    more = _vector_math(group, "SUBTRACT", gains, (1.0, 1.0, 1.0))
    added = _vector_math(group, "MULTIPLY_ADD", more, (0.5 / SH_C0,) * 3, scaled)
    apart = new("ShaderNodeSeparateXYZ")
    link(added, apart.inputs[0])
    for k in range(3):
        link(apart.outputs[k], whole.inputs[k])
    link(parts.outputs["Alpha"], whole.inputs["Alpha"])
    looks = _store(group, looks, BASE, "FLOAT_COLOR", whole.outputs[0], read.outputs["Exists"])
    plain = _unless_equal(group, gains, (1.0, 1.0, 1.0), looks, splats.outputs[0])
    instance = new("GeometryNodeGeometryToInstance")  # a transform then turns shapes and SH, too
    link(plain, instance.inputs[0])
    turned = _transformed(group, instance.outputs[0], applied)
    for name, axis in zip(APPLIED, np.eye(3).tolist(), strict=True):
        plain = _unless_equal(group, start.outputs[name], axis, turned, plain)
    link(plain, end.inputs[0])
    made: bpy.types.NodeTree = group
    return made


def _applied(group: Any, start: Any) -> Any:
    """A matrix of the inputs `APPLIED` of the group."""
    matrix = group.nodes.new("FunctionNodeCombineMatrix")
    for column, name in enumerate(APPLIED):
        apart = group.nodes.new("ShaderNodeSeparateXYZ")
        group.links.new(start.outputs[name], apart.inputs[0])
        for row in range(3):
            group.links.new(apart.outputs[row], matrix.inputs[4 * column + row])
    return matrix.outputs[0]


def _transformed(group: Any, geometry: Any, matrix: Any) -> Any:
    """Geometry with its points or instances moved by a matrix."""
    node = group.nodes.new("GeometryNodeTransform")
    node.inputs["Mode"].default_value = "Matrix"
    group.links.new(geometry, node.inputs["Geometry"])
    group.links.new(matrix, node.inputs["Transform"])
    return node.outputs[0]


def _unless_equal(
    group: Any, vector: Any, usual: Sequence[float], changed: Any, unchanged: Any
) -> Any:
    """Return the geometry `changed` if a vector differs from `usual`, else `unchanged`."""
    same, chosen = (group.nodes.new(n) for n in ("FunctionNodeCompare", "GeometryNodeSwitch"))
    same.data_type, same.mode, same.operation = "VECTOR", "ELEMENT", "EQUAL"
    group.links.new(vector, _enabled(same.inputs)[0])
    _enabled(same.inputs)[1].default_value = usual
    chosen.input_type = "GEOMETRY"
    group.links.new(same.outputs[0], chosen.inputs[0])
    group.links.new(changed, _enabled(chosen.inputs)[1])
    group.links.new(unchanged, _enabled(chosen.inputs)[2])
    return _enabled(chosen.outputs)[0]


def _enabled(sockets: Any) -> list[Any]:
    """Return a node's sockets that its settings enable."""
    return [socket for socket in sockets if socket.enabled]


def _vector_math(group: Any, operation: str, *values: Any, scale: Any = None) -> Any:
    """Add a vector-math node and return its output; `values` are sockets or numbers."""
    node = group.nodes.new("ShaderNodeVectorMath")
    node.operation = operation
    if scale is not None:
        group.links.new(scale, node.inputs["Scale"])
    for socket, value in zip(node.inputs, values, strict=False):
        if isinstance(value, tuple):
            socket.default_value = value
        else:
            group.links.new(value, socket)
    return node.outputs[0]


def _attribute(group: Any, name: str, kind: str) -> Any:
    node = group.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return node


def _store(group: Any, geometry: Any, name: str, kind: str, value: Any, there: Any) -> Any:
    """Return geometry with an attribute overwritten where it exists."""
    node = group.nodes.new("GeometryNodeStoreNamedAttribute")
    node.data_type, node.domain = kind, "POINT"
    node.inputs["Name"].default_value = name
    for source, socket in ((geometry, "Geometry"), (there, "Selection"), (value, "Value")):
        group.links.new(source, node.inputs[socket])
    return node.outputs[0]
