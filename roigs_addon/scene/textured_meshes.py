"""Blender meshes with a texture, from the engine's files."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..geometry.glb import TexturedMesh


def new_mesh(name: str, read: TexturedMesh) -> bpy.types.Mesh:
    """A smooth mesh in the frame of its file, with one UV map and no material."""
    mesh = bpy.data.meshes.new(name)
    count = len(read.corners)
    mesh.vertices.add(len(read.vertices))
    mesh.loops.add(3 * count)
    mesh.polygons.add(count)
    mesh.vertices.foreach_set("co", read.vertices.ravel())
    mesh.loops.foreach_set("vertex_index", read.corners.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    layer: Any = mesh.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", read.uv.ravel())
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    return mesh


def packed_picture(name: str, data: bytes) -> bpy.types.Image:
    """Create a picture packed into the .blend, from the bytes of an image file."""
    image = bpy.data.images.new(name, 1, 1)
    image.pack(data=data, data_len=len(data))
    image.source = "FILE"
    return image


def blank_material(name: str) -> Any:
    """Create a material with an empty node tree."""
    material: Any = bpy.data.materials.new(name)
    if material.node_tree is None:  # before Blender 5
        material.use_nodes = True
    material.node_tree.nodes.clear()
    return material


def image_nodes(material: Any) -> list[Any]:
    """The nodes with a picture in a material."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree else ()
    return [n for n in nodes if n.bl_idname == "ShaderNodeTexImage" and n.image is not None]
