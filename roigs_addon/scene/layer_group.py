"""The node group that merges the engine's layer with Blender's picture, by depth.

Gaussians nearer than Blender's surface are drawn over it, others below it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

NAME = "ROI-GS Gaussians"
MARK = "roigs_layer"
"""Custom property of the group, and of its images: the kind of engine file that they show."""
INDEX, MATTE, WANTED = "Object Index", "Matte", "Matte Index"
OF_OBJECTS = (INDEX, MATTE)
"""Outputs that tell objects apart: an index like Blender's pass, and one object's share."""
MATTES = ("index", "share")
"""Kinds of images that these outputs need."""
SOCKETS = (
    ("Image", "INPUT", "Color"),
    ("Depth", "INPUT", "Float"),
    (INDEX, "INPUT", "Float"),
    (
        WANTED,
        "INPUT",
        "Int" if bpy.app.version >= (4, 5) else "Float",
    ),  # before 4.5, none has integer sockets
    ("Image", "OUTPUT", "Color"),
    ("Depth", "OUTPUT", "Float"),
    ("Gaussians", "OUTPUT", "Float"),
    (INDEX, "OUTPUT", "Float"),
    (MATTE, "OUTPUT", "Float"),
)
LAST_FRAME = 1048574
MOST_INDEX = 32767
HALF = 0.5
"""Least share of the Gaussians in a pixel that gets their depth and index. It is the default of
Blender's Alpha Threshold, which decides the same for its own passes."""
FAR = 1e11
"""Beyond the depth that Blender and the engine give to empty pixels."""


def new_group() -> Any:
    """Create the group: Blender's picture and passes in; picture and passes with Gaussians out.

    A negative depth from the engine means that Gaussians behind Blender's surfaces are already
    left out.
    """
    group: Any = bpy.data.node_groups.new(NAME, "CompositorNodeTree")
    group[MARK] = True
    for name, way, kind in SOCKETS:
        socket = group.interface.new_socket(name, in_out=way, socket_type=f"NodeSocket{kind}")
        socket.hide_value = name == INDEX  # it comes from Blender's pass
        if name == WANTED:
            socket.min_value, socket.max_value, socket.default_value = 0, MOST_INDEX, 1
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    colour, depth = (_image_node(group, kind) for kind in ("colour", "depth"))
    nearer = _math_node(group, "LESS_THAN", depth.outputs["Image"], start.outputs["Depth"])
    below, above = (group.nodes.new("CompositorNodeAlphaOver") for _ in range(2))
    chosen, (factor, if_not, if_so), merged = _choice_node(group)
    for source, target in (
        *zip((colour.outputs["Image"], start.outputs[0]), _colours(below), strict=True),
        *zip((start.outputs[0], colour.outputs["Image"]), _colours(above), strict=True),
        (nearer, factor),
        (below.outputs[0], if_not),
        (above.outputs[0], if_so),
        (merged, end.inputs[0]),
    ):
        group.links.new(source, target)
    places = (start, colour, depth), (nearer.node, below, above), (chosen,), ()
    own = set(group.nodes)
    left = _left(group, start, nearer)
    seen = _math_node(group, "MULTIPLY", colour.outputs["Alpha"], left)
    most = _math_node(group, "GREATER_THAN", seen, HALF)
    rest = _math_node(group, "SUBTRACT", 1.0, most)
    distance = _math_node(group, "ABSOLUTE", depth.outputs["Image"])
    counted = _math_node(group, "MULTIPLY_ADD", rest, FAR, distance)
    least = _math_node(group, "MINIMUM", counted, start.outputs["Depth"])
    indices, shares = (_parts(group, _image_node(group, kind)) for kind in MATTES)
    first = _math_node(group, "MULTIPLY", indices[0], most)
    index = _math_node(group, "MULTIPLY_ADD", rest, start.outputs[INDEX], first)
    share = _math_node(group, "MULTIPLY", _matte(group, start, indices, shares), left)
    for number, source in enumerate((least, seen, index, share), start=1):
        group.links.new(source, end.inputs[number])
    _place((*places, [node for node in group.nodes if node not in own], (end,)))
    return group


def _left(group: Any, start: Any, nearer: Any) -> Any:
    """Return the share of the Gaussians not hidden by Blender's picture: all if they are nearer."""
    alpha = group.nodes.new("CompositorNodeSeparateColor")
    group.links.new(start.outputs["Image"], alpha.inputs[0])
    clear = _math_node(group, "SUBTRACT", 1.0, alpha.outputs["Alpha"])
    return _math_node(group, "MAXIMUM", nearer, clear)


def _matte(group: Any, start: Any, indices: Iterable[Any], shares: Iterable[Any]) -> Any:
    """The sum of the shares whose index is the wanted one."""
    total: Any = 0.0
    for index, share in zip(indices, shares, strict=True):
        wanted = _math_node(group, "COMPARE", index, start.outputs[WANTED], HALF)
        total = _math_node(group, "MULTIPLY_ADD", wanted, share, total)
    return total


def _parts(group: Any, image: Any) -> list[Any]:
    """The three numbers of an image's pixels."""
    parts = group.nodes.new("CompositorNodeSeparateColor")
    group.links.new(image.outputs["Image"], parts.inputs[0])
    return list(parts.outputs)[:3]


def _place(columns: Iterable[Iterable[Any]]) -> None:
    """Lay nodes out in columns from the left; long columns are split."""
    x = 0
    for column in columns:
        for number, node in enumerate(column):
            node.location = 300 * (x + number // 8), -350 * (number % 8)
        x += 1 + max(0, len(list(column)) - 1) // 8


# In Blender 5, shader nodes replace the compositor's own ones.


def _math_node(group: Any, operation: str, *operands: Any) -> Any:
    """Add a math node and return its output; operands are numbers or outputs of other nodes."""
    node = either(group, "ShaderNodeMath", "CompositorNodeMath")
    node.operation = operation
    for socket, operand in zip(node.inputs, operands, strict=False):
        if isinstance(operand, float):
            socket.default_value = operand
        else:
            group.links.new(operand, socket)
    return node.outputs[0]


def _choice_node(group: Any) -> tuple[Any, tuple[Any, Any, Any], Any]:
    """Add a node that chooses between two colours.

    Returns the node, its inputs (factor, colour for 0, colour for 1), and its output.
    """
    node = either(group, "ShaderNodeMix", "CompositorNodeMixRGB")
    if node.bl_idname == "ShaderNodeMix":
        node.data_type = "RGBA"
    factor, if_not, if_so = [socket for socket in node.inputs if socket.enabled][:3]
    return node, (factor, if_not, if_so), next(o for o in node.outputs if o.enabled)


def _colours(over: Any) -> tuple[Any, Any]:
    """Background and foreground of an Alpha Over node."""
    below, above = [socket for socket in over.inputs if socket.type == "RGBA"]
    return below, above


def either(group: Any, new: str, old: str) -> Any:
    """Add a node of the old type if this Blender has it, else of the new one."""
    return group.nodes.new(old if hasattr(bpy.types, old) else new)


def _image_node(group: Any, kind: str) -> Any:
    """Add a node that shows the files of a kind, one for each frame."""
    image: Any = bpy.data.images.new(f"{NAME} {kind}", 1, 1)
    image.source = "SEQUENCE"
    image[MARK] = kind
    image.colorspace_settings.name = "sRGB" if kind == "colour" else "Non-Color"
    if kind == "colour":
        image.alpha_mode = "STRAIGHT"
    node = group.nodes.new("CompositorNodeImage")
    node.image = image
    node.frame_duration = LAST_FRAME
    node.frame_start, node.frame_offset = 1, 0
    node.use_auto_refresh = True
    return node
