"""Cycles' shadow-catcher pass, and the node that multiplies the Gaussians by it.

The pass is the ratio of the light that a catcher receives with and without the objects. It is
coloured, above 1 in the light of the user's lamps, and 1 without a catcher. While it is rendered,
Blender's picture itself is empty at a catcher, for any film setting.
"""

from __future__ import annotations

from typing import Any

import bpy

from ..stage_properties import stage_props
from . import compositor, layer_group

CYCLES = "CYCLES"
"""The render engine that has shadow catchers."""
SOCKET = "Shadows"
"""Input of the group that merges Gaussians with Blender's picture."""
PASS = "Shadow Catcher"
"""Output of a render layer's node."""
NODE = "ROI-GS Shadows"
"""Name of the node in the group that multiplies."""
CONTACT, NEAR = "ROI-GS Contact", 0.2
"""Label of the nodes that move Blender's surfaces nearer to the camera, and by how many radii of
the user's object. The Gaussians of the surface under it are some millimetres above or below its
foot. They would cover the foot, without its shadow. At 0.2, they may err by 3 degrees, seen
from 15."""
WHOLE, NOWHERE = 0.9, 1e10
"""Least alpha of a pixel that shows only the user's objects, and the depth given to other pixels. A
pixel at an object's rim can have the depth of the catcher behind it. A neighbour inside the object
has the object's depth."""


def is_on(layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer renders the pass."""
    of_cycles: Any = getattr(layer, "cycles", None)
    return bool(of_cycles is not None and of_cycles.use_pass_shadow_catcher)


def switch(layer: bpy.types.ViewLayer, *, on: bool) -> None:
    """Switch the pass on or off; do nothing without Cycles."""
    of_cycles: Any = getattr(layer, "cycles", None)
    if of_cycles is not None and of_cycles.use_pass_shadow_catcher != on:
        of_cycles.use_pass_shadow_catcher = on


def multiplies(scene: bpy.types.Scene) -> bool:
    """Whether renders multiply the Gaussians by the pass."""
    group = compositor.find(scene)
    return group is not None and NODE in group.nodes


def connect(scene: bpy.types.Scene) -> None:
    """Render the pass, and multiply the Gaussians by it. Repeated calls change nothing more.

    Other render engines do not have the pass, and a link to it would make the Gaussians black. So
    there it is not linked. Call `connect` again when the render engine changes.
    """
    group: Any = compositor.find(scene)
    for tree, node in compositor.nodes(scene):
        layers = _layers(scene, tree, node)
        if layers is None:
            continue
        layer = scene.view_layers.get(layers.layer) or scene.view_layers[0]
        switch(layer, on=True)
        if NODE not in group.nodes and not _insert(group):
            continue
        _bring_nearer(group, NEAR * stage_props(scene).radius)
        source, target = layers.outputs.get(PASS), node.inputs.get(SOCKET)
        if target is not None:
            target.default_value = (1.0, 1.0, 1.0, 1.0)  # a node that was there first has black
        if scene.render.engine != CYCLES:
            for link in list(target.links) if target is not None else []:
                tree.links.remove(link)
        elif source is not None and target is not None and not target.is_linked:
            tree.links.new(source, target)


def disconnect(scene: bpy.types.Scene) -> None:
    """Stop multiplying; the view layers' passes stay."""
    group: Any = compositor.find(scene)
    if group is None or NODE not in group.nodes:
        return
    product = group.nodes[NODE]
    colours = product.inputs[_colours(product)[0]].links
    for link in list(product.outputs[_result(product)].links) if colours else []:
        group.links.new(colours[0].from_socket, link.to_socket)
    group.nodes.remove(product)
    for node in [n for n in group.nodes if n.label == CONTACT]:
        for link in list(node.outputs[0].links):
            depth = _start(group).outputs.get("Depth")
            if link.to_node.label != CONTACT and depth is not None:
                group.links.new(depth, link.to_socket)
    for node in [n for n in group.nodes if n.label == CONTACT]:
        group.nodes.remove(node)
    for item in [i for i in group.interface.items_tree if i.name == SOCKET]:
        group.interface.remove(item)


def _layers(scene: bpy.types.Scene, tree: Any, node: Any) -> Any | None:
    """Return the render layer whose picture a node merges, even through other nodes."""
    found = [n for n in tree.nodes if n.type == "R_LAYERS" and n.scene in (scene, None)]
    links = [link for socket in node.inputs[1:2] for link in socket.links]  # its depth input
    straight = [link.from_node for link in links if link.from_node in found]
    return next(iter(straight or found), None)


def _insert(group: Any) -> bool:
    """Multiply the Gaussians' colours by an input, right after they are read.

    Returns False if a user has changed the group and it lacks the nodes for this.
    """
    colour = next((node for node in group.nodes if _shows_colour(node)), None)
    start = next((node for node in group.nodes if node.type == "GROUP_INPUT"), None)
    if colour is None or start is None:
        return False
    socket = group.interface.new_socket(SOCKET, in_out="INPUT", socket_type="NodeSocketColor")
    socket.default_value = (1.0, 1.0, 1.0, 1.0)
    product = layer_group.either(group, "ShaderNodeMix", "CompositorNodeMixRGB")
    product.name = product.label = NODE
    if product.bl_idname == "ShaderNodeMix":
        product.data_type = "RGBA"
    product.blend_type = "MULTIPLY"
    product.inputs[0].default_value = 1.0
    product.location = colour.location.x + 150, colour.location.y + 250
    first, second = _colours(product)
    followers = [link.to_socket for link in colour.outputs["Image"].links]
    group.links.new(colour.outputs["Image"], product.inputs[first])
    group.links.new(start.outputs[SOCKET], product.inputs[second])
    for follower in followers:
        group.links.new(product.outputs[_result(product)], follower)
    return True


def _start(group: Any) -> Any:
    return next(node for node in group.nodes if node.type == "GROUP_INPUT")


def _bring_nearer(group: Any, by: float) -> None:
    """Draw Gaussians over Blender's surfaces only where they are nearer by at least `by`."""
    contact = group.nodes.get(CONTACT)
    if contact is None:
        contact = _contact(group)
    if contact is not None:
        contact.inputs[1].default_value = by


def _contact(group: Any) -> Any | None:
    """Add nodes between Blender's depth and its comparison; return the one that subtracts.

    None if a user has changed the group.
    """
    found = [n for n in group.nodes if getattr(n, "operation", "") == "LESS_THAN"]
    picture, depth = (_start(group).outputs.get(name) for name in ("Image", "Depth"))
    if not found or not found[0].inputs[1].is_linked or picture is None or depth is None:
        return None
    contact, part, whole, least = (
        layer_group.either(group, "ShaderNodeMath", "CompositorNodeMath") for _ in range(4)
    )
    alpha, rim = (group.nodes.new(f"CompositorNode{k}") for k in ("SeparateColor", "DilateErode"))
    for number, node in enumerate((contact, alpha, part, whole, rim, least)):
        node.name = node.label = CONTACT
        node.location = found[0].location.x - 150 * number, found[0].location.y + 250
    contact.operation, part.operation, least.operation = "SUBTRACT", "LESS_THAN", "MINIMUM"
    whole.operation = "MULTIPLY_ADD"
    part.inputs[1].default_value, whole.inputs[1].default_value = WHOLE, NOWHERE
    if "Size" in rim.inputs:
        rim.inputs["Size"].default_value = -1
    else:  # before Blender 4.5
        rim.distance = -1
    for source, target in (
        (picture, alpha.inputs[0]),
        (alpha.outputs["Alpha"], part.inputs[0]),
        (part.outputs[0], whole.inputs[0]),
        (depth, whole.inputs[2]),
        (whole.outputs[0], rim.inputs[0]),
        (rim.outputs[0], least.inputs[0]),
        (depth, least.inputs[1]),
        (least.outputs[0], contact.inputs[0]),
        (contact.outputs[0], found[0].inputs[1]),
    ):
        group.links.new(source, target)
    return contact


def _shows_colour(node: Any) -> bool:
    """Whether a node reads the Gaussians' colours."""
    image = node.image if node.type == "IMAGE" else None
    return image is not None and image.get(layer_group.MARK) == "colour"


def _colours(product: Any) -> tuple[int, int]:
    """Return the indices of the node's colour inputs."""
    found = [
        i for i, socket in enumerate(product.inputs) if socket.enabled and socket.type == "RGBA"
    ]
    return found[0], found[1]


def _result(product: Any) -> int:
    return next(i for i, socket in enumerate(product.outputs) if socket.enabled)
