"""Relights a captured object: its mesh, with the texture divided by the captured light.

A photo's colour is the colour of the surface times the light that fell on it. The mesh stores the
light at each vertex (`captured_light`). The texture divided by it is the surface's own colour, so
lamps, worlds and shadows affect it like any other object. Reflections in the object's own material
and shadows of single lamps stay in the texture.

The new material is in the object's slots. The mesh keeps its own material, which `remove` restores.
The .blend has everything that the material needs, so it also works without the add-on.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import mesh_of
from ..errors import AddonError
from ..geometry.frames import Matrix
from . import captured_light, clouds, textured_meshes
from .image_pixels import pixels_of

SLIDER = "Relit"
"""Custom property of the object, which may be animated: 0 as captured, 1 relit."""
TEXT = (
    "0: as captured. 1: lit by your lamps and world. Highlights and hard shadows of the photos stay"
    " in the texture"
)
WHITEST = 0.95
"""Largest share of light that a surface may reflect."""
LEAST_LIGHT = 0.01
"""Least divisor, in linear light, so that black corners do not become bright."""
NO_PICTURE = "The material of '{}' has no picture. Make its surface again."


def is_on(item: bpy.types.Object) -> bool:
    """Whether an object is relit."""
    own = any(slot.link == "OBJECT" for slot in item.material_slots)
    return own and item.get(SLIDER) is not None


def is_lacking(item: bpy.types.Object) -> bool:
    """Whether a relit object's mesh lacks its captured light, because it was made again."""
    return is_on(item) and not captured_light.is_stored(mesh_of(item))


def apply(item: bpy.types.Object, picture: NDArray[np.float32], turn: Matrix) -> None:
    """Let lamps and world light an object.

    Args:
        item: a mesh object with a texture.
        picture: (H, W, 3) linear light all around it, where it was captured.
        turn: (3, 3) from the axes of the COLMAP frame to the picture's.

    Raises:
        AddonError: it has no texture.
    """
    mesh = mesh_of(item)
    image = image_of(mesh)
    if image is None:
        raise AddonError(NO_PICTURE.format(item.name))
    captured_light.store(mesh, picture, turn, _mean(image))
    material = _material(f"{item.name} Relit", image)
    remove(item)
    for slot in item.material_slots:
        slot.link = "OBJECT"
        slot.material = material
    add_slider(item)


def add_slider(item: bpy.types.Object, value: float = 1.0) -> None:
    """Give an object the property `SLIDER`."""
    item[SLIDER] = value
    described: Any = item.id_properties_ui
    ends = {"min": 0.0, "max": 1.0, "soft_min": 0.0, "soft_max": 1.0}
    described(SLIDER).update(**ends, default=1.0, description=TEXT)


def remove(item: bpy.types.Object) -> None:
    """Restore the material of an object's mesh."""
    for slot in item.material_slots:
        if slot.link == "OBJECT":
            made = slot.material
            slot.material = None
            slot.link = "DATA"
            if made is not None and not made.users:
                bpy.data.materials.remove(made)
    if item.get(SLIDER) is not None:
        del item[SLIDER]


def image_of(mesh: bpy.types.Mesh) -> bpy.types.Image | None:
    """Return the picture of a mesh's own material; None if there is none."""
    nodes = (node for each in mesh.materials for node in textured_meshes.image_nodes(each))
    return next((node.image for node in nodes), None)


def _mean(image: bpy.types.Image) -> NDArray[np.float32]:
    """(3,) mean colour of a picture's pixels that are not black, in linear light."""
    values = pixels_of(image)[..., :3].reshape(-1, 3)
    used = values[values.any(axis=1)]  # the rest of the texture is black
    return clouds.to_linear(used).mean(axis=0) if len(used) else np.zeros(3, np.float32)


def _material(name: str, image: bpy.types.Image) -> bpy.types.Material:
    """Create the material: emission as captured, mixed with a lit surface by the slider."""
    material = textured_meshes.blank_material(name)
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    new = nodes.new
    texture, light, slider = new("ShaderNodeTexImage"), *(new("ShaderNodeAttribute") for _ in "ab")
    least, own, most = (new("ShaderNodeVectorMath") for _ in range(3))
    shines, lit = new("ShaderNodeEmission"), new("ShaderNodeBsdfPrincipled")
    mix, output = new("ShaderNodeMixShader"), new("ShaderNodeOutputMaterial")
    texture.image = image
    light.attribute_name = captured_light.ATTRIBUTE
    slider.attribute_name, slider.attribute_type = SLIDER, "INSTANCER"  # else the object's
    least.operation, own.operation, most.operation = "MAXIMUM", "DIVIDE", "MINIMUM"
    least.inputs[1].default_value = (LEAST_LIGHT,) * 3
    most.inputs[1].default_value = (WHITEST,) * 3
    lit.inputs["Roughness"].default_value = 1.0
    lit.inputs["Specular IOR Level"].default_value = 0.0  # photos have the highlights
    for source, target in (
        (light.outputs["Color"], least.inputs[0]),
        (texture.outputs["Color"], own.inputs[0]),
        (least.outputs[0], own.inputs[1]),
        (own.outputs[0], most.inputs[0]),
        (most.outputs[0], lit.inputs["Base Color"]),
        (texture.outputs["Color"], shines.inputs["Color"]),
        (slider.outputs["Fac"], mix.inputs[0]),
        (shines.outputs[0], mix.inputs[1]),
        (lit.outputs[0], mix.inputs[2]),
        (mix.outputs[0], output.inputs["Surface"]),
    ):
        link(source, target)
    columns = (light, texture), (least,), (own,), (most,), (slider, shines, lit), (mix,), (output,)
    for x, column in enumerate(columns):
        for y, node in enumerate(column):
            node.location = 220 * x, -280 * y
    made: bpy.types.Material = material
    return made
