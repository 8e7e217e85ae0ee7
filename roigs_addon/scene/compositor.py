"""The scene's compositor, and its node group that merges the engine's layer (layer_group.py).

The compositor gets the group behind its first render layer; other nodes stay as they are.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import bpy

from ..shared import frame_requests
from . import display, layer_group
from .layer_group import MARK

ENDS = ("COMPOSITE", "GROUP_OUTPUT")
LINKED = "roigs_linked"
"""Custom property of a compositor that got the group."""
FILES = {
    "colour": frame_requests.colour_file,
    "depth": frame_requests.depth_file,
    "index": frame_requests.index_file,
    "share": frame_requests.share_file,
}
"""Kind of an image in the group -> path of the engine's file that it shows."""
PASSES = ("Object Index", "IndexOB")
"""Names of Blender's object-index pass: from 5.0 on, and before."""


def link(scene: bpy.types.Scene) -> None:
    """Merge Gaussians into the scene's renders, once; Blender's own splats are not merged."""
    if not display.in_layer(scene):
        return
    tree = _made_tree(scene)
    if find(scene) is None:
        _insert(scene, tree, layer_group.new_group())
    tree[LINKED] = True


def before(scene: Any) -> dict[str, Any] | None:
    """The settings that `link` would change, as JSON, for `unlink`; None if there are none."""
    if find(scene) is not None or not display.in_layer(scene):
        return None
    return {
        "trees": len(trees(scene)),
        "used": len(trees(scene, used=True)),
        "linked": was_linked(scene),
        "layers": any(n.type == "R_LAYERS" for tree in trees(scene) for n in tree.nodes),
        "depth": {layer.name: layer.use_pass_z for layer in scene.view_layers},
    }


def unlink(scene: Any, before: dict[str, Any]) -> None:
    """Undo `link`: take the Gaussians out of renders.

    Nodes that the user has added since stay. If there are any, an added compositor stays too.

    Args:
        scene: whose compositor it is.
        before: result of `before`. Parts of it may be missing: a .blend may hold anything.
    """
    for tree in trees(scene):
        for node in [n for n in tree.nodes if _is_ours(n)]:
            source = next((link.from_socket for link in node.inputs[0].links), None)
            for link in list(node.outputs[0].links) if source is not None else []:
                tree.links.new(source, link.to_socket)
            _remove_group(tree, node)
        for node in [n for n in tree.nodes if n.type == "R_LAYERS"]:
            if not before.get("layers", True) and not any(o.is_linked for o in node.outputs):
                tree.nodes.remove(node)
        if not before.get("linked") and LINKED in tree:
            del tree[LINKED]
    depth: Any = before.get("depth")
    for layer in scene.view_layers if isinstance(depth, dict) else ():
        layer.use_pass_z = bool(depth.get(layer.name, layer.use_pass_z))
    if not before.get("used"):
        _switch_off(scene, made=not before.get("trees"))


def _is_ours(node: Any) -> bool:
    group = getattr(node, "node_tree", None)
    return group is not None and bool(group.get(MARK))


def _remove_group(tree: Any, node: Any) -> None:
    """Delete a node of the group, and the group with its images if nothing else uses them."""
    group = node.node_tree
    tree.nodes.remove(node)
    if group.users:
        return
    images = [n.image for n in group.nodes if n.type == "IMAGE" and n.image is not None]
    bpy.data.node_groups.remove(group)
    bpy.data.batch_remove([image for image in images if not image.users])


def _switch_off(scene: Any, *, made: bool) -> None:
    """Switch the compositor off, or delete it if it was `made` for the group."""
    if hasattr(scene, "compositor_effects") or hasattr(scene, "compositing_node_group"):
        for tree in trees(scene) if made else []:
            if any(node.type not in (*ENDS, "R_LAYERS") for node in tree.nodes):
                continue
            bpy.data.node_groups.remove(tree)
            for effect in list(getattr(scene, "compositor_effects", ())):
                if effect.node_group is None:
                    scene.compositor_effects.remove(effect)
        return
    if not made:
        scene.use_nodes = False
    elif all(node.type in (*ENDS, "R_LAYERS") for node in scene.node_tree.nodes):
        scene.node_tree.nodes.clear()  # Blender keeps a tree that a scene once had
        scene.use_nodes = False


def was_linked(scene: Any) -> bool:
    """Whether `link` has changed the scene's compositor, whatever the user did with it since."""
    return any(tree.get(LINKED) for tree in trees(scene))


def find(scene: bpy.types.Scene) -> Any | None:
    """Return the group in the scene's compositor; None if it is not there."""
    for node in (node for tree in trees(scene, used=True) for node in tree.nodes):
        group = getattr(node, "node_tree", None)
        if group is not None and group.get(MARK):
            return group
    return None


def lacking(scene: bpy.types.Scene) -> str:
    """Why renders lack the Gaussians, in one line; empty if they do not."""
    if find(scene) is None:
        return "Renders lack the Gaussians: their compositor node was removed"
    if not scene.render.use_compositing:
        return "Renders lack the Gaussians. Switch on Output ▸ Post Processing ▸ Compositing"
    return ""


def uses_mattes(scene: bpy.types.Scene) -> bool:
    """Whether an output that tells objects apart is linked. Only then the engine draws mattes."""
    return any(
        socket.is_linked
        for _, node in nodes(scene)
        for socket in node.outputs
        if socket.name in layer_group.OF_OBJECTS
    )


def empty_mattes(scene: bpy.types.Scene, known: Collection[int]) -> str:
    """A warning, in one line, if a matte shows no object; else nothing.

    Args:
        scene: that is rendered.
        known: the indices of objects of Gaussians in it.
    """
    for _, node in nodes(scene):
        matte, wanted = node.outputs.get(layer_group.MATTE), node.inputs.get(layer_group.WANTED)
        if matte is None or not matte.is_linked or wanted is None or wanted.is_linked:
            continue
        if (number := round(wanted.default_value)) not in known:
            return (
                f"Matte is black: no rendered Gaussians have Pass Index {number}. Set it in"
                " Object ▸ Relations, or change Matte Index of the node."
            )
    return ""


def connect_indices(scene: bpy.types.Scene) -> None:
    """Link Blender's object-index pass to the group, if it is rendered and would be used.

    In some Blenders a render layer's node has the output only as long as the pass is on.
    """
    for tree, node in nodes(scene):
        target, used = (s.get(layer_group.INDEX) for s in (node.inputs, node.outputs))
        depth = next((link.from_node for s in node.inputs[1:2] for link in s.links), None)
        if target is None or target.is_linked or not used.is_linked or depth is None:
            continue
        found = [depth.outputs.get(name) for name in PASSES if depth.type == "R_LAYERS"]
        for source in [socket for socket in found if socket is not None and socket.enabled][:1]:
            tree.links.new(source, target)


def nodes(scene: bpy.types.Scene) -> list[tuple[Any, Any]]:
    """Return the group's nodes in the scene's compositor, each with its tree."""
    group = find(scene)
    return [
        (tree, node)
        for tree in trees(scene, used=True)
        for node in tree.nodes
        if group is not None and getattr(node, "node_tree", None) == group
    ]


def point_to(scene: bpy.types.Scene, out: Path) -> None:
    """Have the group read the files of `out`."""
    for image in _images(scene):
        # The file of the sequence's first frame.
        path = str(FILES[image[MARK]](out.with_name(f"{out.name}{1:04d}")))
        if bpy.path.abspath(image.filepath) != path:
            image.filepath = path


def reload(scene: bpy.types.Scene) -> None:
    """Have the group read its files again: Blender keeps those of the last frame in memory."""
    mattes = uses_mattes(scene)
    for image in _images(scene):
        if mattes or image[MARK] not in layer_group.MATTES:  # else there is no such file
            image.reload()


def _images(scene: bpy.types.Scene) -> list[Any]:
    """The images of the group."""
    group = find(scene)
    found = [node.image for node in group.nodes if node.type == "IMAGE"] if group else []
    # Other images come from a user who has changed the group.
    return [i for i in found if i is not None and i.get(MARK) in FILES]


def trees(scene: Any, *, used: bool = False) -> list[Any]:
    """The scene's compositor: none, one, or from Blender 5.3 on several, one after the other.

    `used`: only if it is not switched off.
    """
    if hasattr(scene, "compositor_effects"):  # from Blender 5.3
        found = [effect.node_group for effect in scene.compositor_effects]
    elif hasattr(scene, "compositing_node_group"):  # from Blender 5.0
        found = [scene.compositing_node_group]
    else:
        found = [scene.node_tree] if scene.use_nodes or not used else []
    return [tree for tree in found if tree is not None]


def _made_tree(scene: Any) -> Any:
    """Return the scene's first compositor, or a new one that shows the render layer."""
    for found in trees(scene, used=True):
        return found
    tree: Any
    if hasattr(bpy.types, "CompositorNodeComposite"):  # before Blender 5.0
        fresh = scene.node_tree is None
        scene.use_nodes = True
        tree = scene.node_tree
        if not fresh:  # the user's nodes, which were switched off
            return tree
        tree.nodes.clear()
        end = tree.nodes.new("CompositorNodeComposite")
    else:
        tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        if hasattr(scene, "compositor_effects"):
            scene.compositor_effects.new(name=tree.name).node_group = tree
        else:
            scene.compositing_node_group = tree
        end = tree.nodes.new("NodeGroupOutput")
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    end.location.x = 700
    tree.links.new(layers.outputs["Image"], end.inputs[0])
    return tree


def _insert(scene: bpy.types.Scene, tree: Any, group: Any) -> None:
    """Put the group between the first render layer of the scene and all that follows it."""
    of_scene = [n for n in tree.nodes if n.type == "R_LAYERS" and n.scene in (scene, None)]
    layers: Any = of_scene[0] if of_scene else tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    (scene.view_layers.get(layers.layer) or scene.view_layers[0]).use_pass_z = True
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    node.location = layers.location.x + 350, layers.location.y
    node.width = 200
    for dead in [n for n in tree.nodes if n.type == "GROUP" and n.node_tree is None]:
        tree.nodes.remove(dead)  # such as ours, after the user deleted its group
    followers = [link.to_socket for link in layers.outputs["Image"].links]
    followers += [n.inputs[0] for n in tree.nodes if n.type in ENDS and not n.inputs[0].is_linked]
    tree.links.new(layers.outputs["Image"], node.inputs[0])
    tree.links.new(layers.outputs["Depth"], node.inputs[1])
    for socket in followers:
        tree.links.new(node.outputs[0], socket)
