# SPDX-License-Identifier: GPL-3.0-or-later
"""Building blocks of the demo scene: materials from images, boxes, lathes, grids and text.

Meshes carry texture coordinates in metres, so a material only has to know how large its image is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

Colour = tuple[float, float, float]
IDENTITY = Matrix.Identity(4)


def linear(colour: Sequence[float] | np.ndarray) -> np.ndarray:
    """sRGB to scene-linear."""
    values = np.asarray(colour, np.float32)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def place(
    location: Sequence[float] = (0.0, 0.0, 0.0), turn: Sequence[float] = (0.0, 0.0, 0.0)
) -> Matrix:
    """A rigid placement from a location and XYZ Euler angles in degrees."""
    x, y, z = (math.radians(a) for a in turn)
    rotation = Matrix.Rotation(z, 4, "Z") @ Matrix.Rotation(y, 4, "Y") @ Matrix.Rotation(x, 4, "X")
    return Matrix.Translation(location) @ rotation


def image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Create a Blender image from an array (height, width, 3) of sRGB values."""
    height, width = pixels.shape[:2]
    img = bpy.data.images.new(name, width, height)
    full = np.ones((height, width, 4), np.float32)
    full[..., :3] = np.clip(pixels, 0.0, 1.0)
    img.pixels.foreach_set(full.ravel())
    img.update()
    return img


def image_material(
    name: str,
    img: bpy.types.Image,
    size: tuple[float, float],
    bump: float = 0.0,
    tint: Colour | None = None,
    emission: float = 0.0,
) -> bpy.types.Material:
    """A diffuse material that shows an image of `size` metres."""
    mat = plain_material(name, (1.0, 1.0, 1.0))
    nodes, links = mat.node_tree.nodes, mat.node_tree.links
    shader = nodes["Diffuse BSDF"]
    coords = nodes.new("ShaderNodeTexCoord")
    scale = nodes.new("ShaderNodeMapping")
    scale.inputs["Scale"].default_value = (1.0 / size[0], 1.0 / size[1], 1.0)
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = img
    texture.extension = "MIRROR"
    links.new(coords.outputs["UV"], scale.inputs["Vector"])
    links.new(scale.outputs["Vector"], texture.inputs["Vector"])
    colour = texture.outputs["Color"]
    if tint is not None:
        blend = nodes.new("ShaderNodeMix")
        blend.data_type, blend.blend_type = "RGBA", "MULTIPLY"
        blend.inputs["Factor"].default_value = 1.0
        links.new(colour, blend.inputs["A"])
        blend.inputs["B"].default_value = (*linear(tint), 1.0)
        colour = blend.outputs["Result"]
    links.new(colour, shader.inputs["Color"])
    if emission:
        _glow(mat, colour, emission)
    if bump:
        relief = nodes.new("ShaderNodeBump")
        relief.inputs["Distance"].default_value = bump
        links.new(texture.outputs["Color"], relief.inputs["Height"])
        links.new(relief.outputs["Normal"], shader.inputs["Normal"])
    return mat


def _glow(mat: bpy.types.Material, colour: bpy.types.NodeSocket, strength: float) -> None:
    """Make a material also emit light; it is not sampled, because lamps light the room."""
    nodes, links = mat.node_tree.nodes, mat.node_tree.links
    glow, both = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeAddShader")
    glow.inputs["Strength"].default_value = strength
    links.new(colour, glow.inputs["Color"])
    links.new(nodes["Diffuse BSDF"].outputs["BSDF"], both.inputs[0])
    links.new(glow.outputs["Emission"], both.inputs[1])
    links.new(both.outputs["Shader"], nodes["Material Output"].inputs["Surface"])
    mat.cycles.emission_sampling = "NONE"


def plain_material(name: str, colour: Colour) -> bpy.types.Material:
    """A diffuse material of one sRGB colour."""
    mat = bpy.data.materials.new(name)
    mat.use_nodes = True
    nodes = mat.node_tree.nodes
    nodes.remove(nodes["Principled BSDF"])
    shader = nodes.new("ShaderNodeBsdfDiffuse")
    shader.name = "Diffuse BSDF"
    shader.inputs["Color"].default_value = (*linear(colour), 1.0)
    mat.node_tree.links.new(shader.outputs["BSDF"], nodes["Material Output"].inputs["Surface"])
    return mat


def attribute_material(name: str, attribute: str = "Col") -> bpy.types.Material:
    """A material coloured by a colour attribute of the mesh."""
    mat = plain_material(name, (0.8, 0.8, 0.8))
    node = mat.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = attribute
    shader = mat.node_tree.nodes["Diffuse BSDF"]
    mat.node_tree.links.new(node.outputs["Color"], shader.inputs["Color"])
    return mat


def mesh_object(
    name: str,
    points: np.ndarray,
    faces: Sequence[Sequence[int]] | np.ndarray,
    uv: np.ndarray | None,
    material: bpy.types.Material,
    frame: Matrix = IDENTITY,
    smooth: bool = False,
    roi: str = "",
) -> bpy.types.Object:
    """An object from points and faces; `uv` holds one pair per face corner, in face order."""
    mesh = bpy.data.meshes.new(name)
    if isinstance(faces, np.ndarray):
        _fill(mesh, points, faces)
    else:
        mesh.from_pydata([tuple(p) for p in points], [], [tuple(f) for f in faces])
    if uv is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())
    mesh.materials.append(material)
    if smooth:
        mesh.shade_smooth()
    mesh.update()
    mesh.validate()
    return link(name, mesh, frame, roi)


def colour_points(obj: bpy.types.Object, colours: np.ndarray) -> None:
    """Give every point of a mesh its own colour (sRGB), as the attribute `Col`."""
    layer = obj.data.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
    full = np.ones((len(obj.data.vertices), 4), np.float32)
    full[:, :3] = linear(np.clip(colours.reshape(-1, 3), 0.0, 1.0))
    layer.data.foreach_set("color", full.ravel())


def _fill(mesh: bpy.types.Mesh, points: np.ndarray, quads: np.ndarray) -> None:
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points, np.float32).ravel())
    mesh.loops.add(quads.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(quads, np.int32).ravel())
    mesh.polygons.add(len(quads))
    mesh.polygons.foreach_set("loop_start", np.arange(len(quads), dtype=np.int32) * 4)
    mesh.update(calc_edges=True)


def link(name: str, data: bpy.types.ID, frame: Matrix, roi: str = "") -> bpy.types.Object:
    """Put data into the scene; `roi` names the boxed object that it belongs to."""
    obj = bpy.data.objects.new(name, data)
    obj.matrix_world = frame
    if roi:
        obj["roi"] = roi
    bpy.context.scene.collection.objects.link(obj)
    return obj


def box(
    name: str,
    size: Sequence[float],
    centre: Sequence[float],
    material: bpy.types.Material,
    frame: Matrix = IDENTITY,
    bevel: float = 0.0,
    segments: int = 2,
    fit: bool = False,
    roi: str = "",
) -> bpy.types.Object:
    """A box; the texture runs along the longer side of each face, from a different start on each.

    With `fit`, the texture starts at the lower left corner of each upright face instead.
    """
    half = np.asarray(size, float) / 2.0
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    faces = ((0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5))
    rng = np.random.default_rng(abs(hash_name(name)))
    uv = []
    for face in faces:
        spots = corners[list(face)]
        axes = [a for a in range(3) if np.ptp(spots[:, a]) > 1e-9]
        axes.sort(key=lambda a: -size[a])
        if fit and 2 in axes:
            axes = [a for a in axes if a != 2] + [2]
            pairs = spots[:, axes] + half[axes]
            if face in (faces[3], faces[4]):
                pairs[:, 0] = 2 * half[axes[0]] - pairs[:, 0]
            uv.append(pairs)
        else:
            uv.append(spots[:, axes] + (half[axes] if fit else rng.uniform(0.0, 3.0, 2)))
    obj = mesh_object(
        name,
        corners,
        faces,
        np.concatenate(uv),
        material,
        frame @ Matrix.Translation(centre),
        False,
        roi,
    )
    if bevel:
        modifier = obj.modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, segments
    return obj


def hash_name(name: str) -> int:
    """A number from a name; the same in every run."""
    value = 17
    for char in name:
        value = (value * 131 + ord(char)) % 2147483647
    return value


def grid_quads(rows: int, cols: int, wrap: bool) -> np.ndarray:
    """Quads of a grid of points stored row by row; `wrap` closes each row."""
    steps = cols if wrap else cols - 1
    i, j = np.mgrid[0 : rows - 1, 0:steps]
    k = (j + 1) % cols
    return np.stack(
        [i * cols + j, i * cols + k, (i + 1) * cols + k, (i + 1) * cols + j], -1
    ).reshape(-1, 4)


def lathe(
    name: str,
    profile: Sequence[tuple[float, float]],
    material: bpy.types.Material,
    frame: Matrix = IDENTITY,
    segments: int = 48,
    roi: str = "",
    flute: float = 0.0,
    flutes: int = 0,
    twist: float = 0.0,
) -> bpy.types.Object:
    """A turned body from (radius, height) pairs, with optional twisted flutes."""
    radius, height = np.asarray(profile, float).T
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    wave = 1.0 + flute * np.cos(flutes * angle + twist * height[:, None])
    ring = radius[:, None] * wave
    points = np.stack(
        [ring * np.cos(angle), ring * np.sin(angle), np.repeat(height[:, None], segments, 1)], -1
    ).reshape(-1, 3)
    quads = grid_quads(len(radius), segments, True)
    around = max(radius) * np.array([0.0, 1.0, 1.0, 0.0]) * 2 * np.pi / segments
    i, j = np.divmod(np.arange(len(quads)), segments)
    u = around + (max(radius) * j * 2 * np.pi / segments)[:, None]
    v = np.stack([length[i], length[i], length[i + 1], length[i + 1]], -1)
    return mesh_object(name, points, quads, np.stack([u, v], -1), material, frame, True, roi)


def resample(profile: tuple[tuple[float, float], ...], count: int) -> list[tuple[float, float]]:
    """`count` points along the profile of a lathe."""
    values = np.asarray(profile)
    at = np.linspace(0, len(values) - 1, count)
    return [
        (
            float(np.interp(x, np.arange(len(values)), values[:, 0])),
            float(np.interp(x, np.arange(len(values)), values[:, 1])),
        )
        for x in at
    ]


def sheet(
    name: str,
    points: np.ndarray,
    size: tuple[float, float],
    material: bpy.types.Material,
    frame: Matrix = IDENTITY,
    roi: str = "",
) -> bpy.types.Object:
    """A surface from a grid of points (rows, columns, 3) whose texture spans `size` metres."""
    rows, cols = points.shape[:2]
    quads = grid_quads(rows, cols, False)
    i, j = np.divmod(quads, cols)
    uv = np.stack([j / (cols - 1) * size[0], i / (rows - 1) * size[1]], -1)
    return mesh_object(name, points.reshape(-1, 3), quads, uv, material, frame, True, roi)


def panel(
    name: str,
    size: tuple[float, float],
    material: bpy.types.Material,
    frame: Matrix,
    roi: str = "",
) -> bpy.types.Object:
    """A flat rectangle in the local XZ plane, centred, facing -Y, textured from its corner."""
    w, h = size[0] / 2, size[1] / 2
    points = np.array([[[-w, 0, -h], [w, 0, -h]], [[-w, 0, h], [w, 0, h]]], float)
    return sheet(name, points, size, material, frame, roi)


def text(
    name: str,
    body: str,
    height: float,
    material: bpy.types.Material,
    frame: Matrix,
    depth: float = 0.0003,
    width: float = 0.0,
    align: str = "CENTER",
    roi: str = "",
    spacing: float = 1.05,
) -> bpy.types.Object:
    """Raised lettering in the local XZ plane facing -Y, centred on the frame's origin.

    `width` limits the width of the block: longer lines are made narrower.
    """
    curve = bpy.data.curves.new(name, "FONT")
    curve.body = body
    curve.size = height
    curve.extrude = depth
    curve.resolution_u = 3
    curve.align_x, curve.align_y = align, "CENTER"
    curve.space_character = spacing
    source = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(source)
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(source.evaluated_get(graph))
    bpy.data.objects.remove(source)
    mesh.materials.clear()
    mesh.materials.append(material)
    points = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", points)
    points = points.reshape(-1, 3)
    extent = float(np.ptp(points[:, 0])) if len(points) else 0.0
    if width and extent > width:
        points[:, 0] *= width / extent
    points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], -1)
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points).ravel())
    mesh.update()
    return link(name, mesh, frame, roi)
