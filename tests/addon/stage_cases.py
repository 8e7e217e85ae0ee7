"""Files as the engine makes them for the user's own objects, and what a scene has of its own."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

CODE = """
import shutil
from pathlib import Path
with Path("ARGUMENTS").open("a") as file:
    file.write(json.dumps(sys.argv[1:]) + "\\n")
say(event="stagestarted", stage="fusion", total=9)
given = dict(part[2:].partition("=")[::2] for part in sys.argv if part.startswith("--"))
if sys.argv[1] == "surface":
    shutil.copy("MADE/background.glb", "RUN/rois/background.glb")
else:
    shutil.copy("MADE/panorama.hdr", given["out"])
say(event="done", outputs={})
"""
"""A fake engine: writes down its commands, and copies what is made."""


def flat_floor() -> dict[str, np.ndarray]:
    """Grey, opaque Gaussians at z = 0."""
    x, y = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(-3, 3, 61)]))
    count = len(x)
    flat = np.log(np.array([0.08, 0.08, 0.001]))
    arrays = {
        "means": np.stack([x, y, 0 * x], axis=1),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "log_scales": np.tile(flat, (count, 1)),
        "logit_opacities": np.full(count, 4.0),
        "sh": np.zeros((count, 1, 3)),
    }
    return {name: values.astype(np.float32) for name, values in arrays.items()}


def write_panorama(bpy: ModuleType, path: Path, *, high: float = 1.0, low: float = 0.1) -> None:
    """A picture all around that is `high` above the horizon and `low` below it."""
    image = bpy.data.images.new("panorama", 32, 16, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"  # else Blender encodes what it saves
    pixels = np.full((16, 32, 4), low, np.float32)
    pixels[8:], pixels[..., 3] = high, 1.0
    image.pixels.foreach_set(pixels.ravel())
    path.parent.mkdir(parents=True, exist_ok=True)
    image.filepath_raw, image.file_format = str(path), "HDR"
    image.save()
    bpy.data.images.remove(image)


def tree_state(tree) -> list[object]:
    """Nodes with their places, settings of their inputs, and links."""
    if tree is None:
        return []
    nodes = [
        (
            node.name,
            node.bl_idname,
            tuple(node.location),
            tuple(
                tuple(socket.default_value)
                if hasattr(socket.default_value, "__len__")
                else socket.default_value
                for socket in node.inputs
                if hasattr(socket, "default_value")
            ),
        )
        for node in tree.nodes
    ]
    links = [
        (each.from_node.name, each.from_socket.identifier, each.to_node.name, each.to_socket.name)
        for each in tree.links
    ]
    inner = [tree_state(node.node_tree) for node in tree.nodes if getattr(node, "node_tree", None)]
    return [sorted(map(repr, nodes)), sorted(links), inner]


def state(bpy: ModuleType, scene) -> dict[str, object]:
    """All of a scene that is the user's and that light, shadows and reflections touch."""
    from roigs_addon.scene import compositor, shadow_pass

    return {
        "world": scene.world and scene.world.name,
        "world nodes": tree_state(scene.world.node_tree) if scene.world else [],
        "film": scene.render.film_transparent,
        "compositing": scene.render.use_compositing,
        "persistent": scene.render.use_persistent_data,
        "engine": scene.render.engine,
        "layers": {
            layer.name: [
                *(shadow_pass.is_on(layer), layer.use, layer.samples),
                *(getattr(layer, name) for name in dir(layer) if name.startswith("use_pass_")),
            ]
            for layer in scene.view_layers
        },
        "lamps": {i.name: i.is_shadow_catcher for i in scene.objects if i.type == "LIGHT"},
        "compositors": (len(compositor.trees(scene)), len(compositor.trees(scene, used=True))),
        "compositor": [tree_state(tree) for tree in compositor.trees(scene)],
        "collections": sorted(each.name for each in bpy.data.collections),
        "objects": sorted(each.name for each in scene.objects),
        "worlds": sorted(each.name for each in bpy.data.worlds),
        "materials": sorted(each.name for each in bpy.data.materials),
        "meshes": sorted(each.name for each in bpy.data.meshes),
        "images": sorted(each.name for each in bpy.data.images),
    }


def own_things(bpy: ModuleType, scene) -> None:
    """Give a scene a world with nodes, a second view layer, and nodes in its compositor."""
    from roigs_addon.scene import compositor

    world = bpy.data.worlds.new("Mine")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs[0].default_value = (0.2, 0.4, 0.8, 1.0)
    scene.world = world
    scene.view_layers.new("Extra")
    scene.render.film_transparent = False
    tree = compositor.trees(scene)[0]
    node = next(n for n in tree.nodes if n.bl_idname == "CompositorNodeGroup")
    blur = tree.nodes.new("CompositorNodeBlur")
    target = node.outputs[0].links[0].to_socket
    tree.links.new(node.outputs[0], blur.inputs["Image"])
    tree.links.new(blur.outputs[0], target)
