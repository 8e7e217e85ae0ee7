"""A world with the captured light around a point, invisible to the camera.

It is a copy of the user's world. The camera still sees the user's world; all other rays hit the
picture.
"""

from __future__ import annotations

from typing import Any

import bpy
from mathutils import Vector

from ..stage_properties import stage_props
from . import proxies, stage

NAME = "ROI-GS Light"
STRENGTH, HIGHLIGHTS = "Strength", "Highlights"
"""Names of the nodes with a value for the user."""
PHOTO_WHITE = (1.0, 1.0, 1.0)
"""Brightest colour in photos; brighter light was recovered."""


def light(scene: bpy.types.Scene) -> bpy.types.World | None:
    """Return our world if it is the scene's world now; None if not."""
    own = stage_props(scene).world
    return own if own is not None and scene.world == own else None


def picture(scene: bpy.types.Scene) -> bpy.types.Image | None:
    """The picture of the light; None if there is no light."""
    own: Any = stage_props(scene).world
    nodes = own.node_tree.nodes if own is not None else ()
    turn = stage_props(scene).turn
    for node in (n for n in nodes if n.type == "TEX_ENVIRONMENT"):
        if any(link.from_node.object == turn for link in node.inputs["Vector"].links):
            image: bpy.types.Image | None = node.image
            return image
    return None


def value(world: Any, name: str) -> Any | None:
    """Return the socket with a value for the user, which may be animated; None without its node."""
    node = world.node_tree.nodes.get(name) if world.node_tree is not None else None
    return node.outputs[0] if node is not None else None


def shine(
    scene: bpy.types.Scene,
    image: bpy.types.Image,
    frame: bpy.types.Object | None,
    at: Vector,
    mirror: bpy.types.Image | None = None,
) -> None:
    """Let the world emit a picture; an earlier one is replaced.

    Args:
        scene: the lit scene.
        image: equirectangular, in linear light, as an Environment Texture shows it.
        frame: the object in whose frame the picture is; None for the world.
        at: place of the picture, in the world.
        mirror: the picture that mirrors and glass see; None for `image`.
    """
    group = stage_props(scene)
    old, kept = group.world, {}
    if old is not None:
        for name in (STRENGTH, HIGHLIGHTS):
            if (socket := value(old, name)) is not None:
                kept[name] = socket.default_value
    if old is None or scene.world != old:
        group.world_before = scene.world
    stage.keep(scene, "world", "")
    stage.follow(scene, frame, at)
    own = _copied(group.world_before)
    _build(own, (image, mirror), group.turn, kept)
    _sample(own, image)
    scene.world = group.world = own
    proxies.use_light(scene, image)
    if old is not None:
        stage.remove_world(old)


def _copied(users: bpy.types.World | None) -> Any:
    """Return a world with nodes that looks like the user's: a copy, or a world of its colour."""
    always = bpy.app.version >= (5, 0, 0)  # worlds always use nodes, and the switch is deprecated
    if users is not None and users.node_tree is not None and (always or users.use_nodes):
        own: Any = users.copy()
        own.name = NAME
        return own
    own = bpy.data.worlds.new(NAME)
    if own.node_tree is None:  # before Blender 5
        own.use_nodes = True
    own.node_tree.nodes.clear()
    shown = own.node_tree.nodes.new("ShaderNodeBackground")
    output = own.node_tree.nodes.new("ShaderNodeOutputWorld")
    output.location.x = 300
    colour: Any = users.color if users is not None else (0.0, 0.0, 0.0)
    shown.inputs["Color"].default_value = (*colour, 1.0)
    own.node_tree.links.new(shown.outputs[0], output.inputs["Surface"])
    return own


def _sample(own: Any, image: bpy.types.Image) -> None:
    """Set Cycles' importance map to the width of the picture.

    By default, Cycles makes a map several times as large, which costs seconds a frame.
    """
    of_cycles: Any = getattr(own, "cycles", None)
    if of_cycles is not None and image.size[0] > 0:
        of_cycles.sampling_method = "MANUAL"
        of_cycles.sample_map_resolution = image.size[0]


Pictures = tuple[bpy.types.Image, bpy.types.Image | None]
"""The picture of the light, and the one that mirrors and glass see if it differs."""


def _build(own: Any, images: Pictures, turn: Any, kept: dict[str, float]) -> None:
    """Put the picture between the user's nodes and the outputs, for all rays but the camera's."""
    nodes, link = own.node_tree.nodes, own.node_tree.links.new
    outputs = [node for node in nodes if node.type == "OUTPUT_WORLD"]
    for node in outputs or [nodes.new("ShaderNodeOutputWorld")]:
        users = [each.from_socket for each in node.inputs["Surface"].links]
        rays, choice = nodes.new("ShaderNodeLightPath"), nodes.new("ShaderNodeMixShader")
        link(rays.outputs["Is Camera Ray"], choice.inputs[0])
        link(_shine(own, images, turn, kept), choice.inputs[1])
        for socket in users:
            link(socket, choice.inputs[2])
        link(choice.outputs[0], node.inputs["Surface"])
        x, y = node.location
        node.location.x = x + 300
        choice.location, rays.location = (x + 50, y), (x - 150, y + 350)


def _shine(own: Any, images: Pictures, turn: Any, kept: dict[str, float]) -> Any:
    """Add the light's shader; rays from mirrors and through glass meet the other picture."""
    nodes, link = own.node_tree.nodes, own.node_tree.links.new
    place = nodes.new("ShaderNodeTexCoord")
    place.object, place.location = turn, (-220 * PICTURE_NODES, -300)
    values = [_value(own, name, kept) for name in (STRENGTH, HIGHLIGHTS)]
    light = _of_picture(own, place.outputs["Object"], images[0], values, -300)
    if images[1] is None:
        return light
    mirror = _of_picture(own, place.outputs["Object"], images[1], values, -900)
    rays, either, choice = (
        nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "Math", "MixShader")
    )
    either.operation = "MAXIMUM"
    for source, target in (
        (rays.outputs["Is Glossy Ray"], either.inputs[0]),
        (rays.outputs["Is Transmission Ray"], either.inputs[1]),
        (either.outputs[0], choice.inputs[0]),
        (light, choice.inputs[1]),
        (mirror, choice.inputs[2]),
    ):
        link(source, target)
    for number, node in enumerate((rays, either, choice)):
        node.location = 220 * (number - 3), -1200
    return choice.outputs[0]


PICTURE_NODES = 7
"""Columns of nodes in the row of a picture: coordinates, picture, three for colour, shader, gap."""


def _of_picture(own: Any, way: Any, image: bpy.types.Image, values: list[Any], row: int) -> Any:
    """Add a picture's shader; light brighter than the photos' white has its own factor.

    Each picture has its own shader, because Cycles skips shaders that a ray does not need.
    """
    nodes, link = own.node_tree.nodes, own.node_tree.links.new
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image, colour = image, picture.outputs["Color"]
    white, excess, total = (nodes.new("ShaderNodeVectorMath") for _ in range(3))
    white.operation, excess.operation, total.operation = "MINIMUM", "SUBTRACT", "MULTIPLY_ADD"
    white.inputs[1].default_value = PHOTO_WHITE
    strength, highlights = values
    shader = nodes.new("ShaderNodeBackground")
    for source, target in (
        (way, picture.inputs["Vector"]),
        (colour, white.inputs[0]),
        (colour, excess.inputs[0]),
        (white.outputs[0], excess.inputs[1]),
        (excess.outputs[0], total.inputs[0]),
        (highlights, total.inputs[1]),
        (white.outputs[0], total.inputs[2]),
        (total.outputs[0], shader.inputs["Color"]),
        (strength, shader.inputs["Strength"]),
    ):
        link(source, target)
    for number, node in enumerate((picture, white, excess, total, shader), start=1):
        node.location = 220 * (number - PICTURE_NODES), row
    return shader.outputs[0]


def _value(own: Any, name: str, kept: dict[str, float]) -> Any:
    """Add a node with a number for the user, or find it, and return its output."""
    node = own.node_tree.nodes.get(name) or own.node_tree.nodes.new("ShaderNodeValue")
    node.name = node.label = name
    node.location = -220 * PICTURE_NODES, -500 if name == STRENGTH else -650
    node.outputs[0].default_value = kept.get(name, 1.0)
    return node.outputs[0]
