"""Proxies: meshes that represent captured surfaces in renders, for the user's own objects.

For camera rays, a proxy is an invisible shadow catcher of Cycles. For all other rays, it emits the
light in the photos and hides the world behind it, so no light is counted twice. Near surfaces emit
their own light, with the right parallax. Beyond `REACH`, proxies let the world's light through: its
picture shows far surfaces, including lamps, as seen from the picture's place. Mirrors and glass see
a picture without lamps, so they see proxies at any distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

from ..blender import mesh_of
from ..errors import AddonError
from ..geometry.glb import read_glb
from ..properties import object_props, scene_props
from ..shared import files, transforms
from ..stage_properties import FAR, stage_props
from . import box_surfaces, lookup, ownership, shadow_pass, stage, textured_meshes
from .node_groups import known_group

BACKGROUND = "Background"
GROUP = "ROI-GS Captured Surface"
"""Node group of the proxies' materials."""
SHADE = "Shade"
"""Input of the group: largest distance of objects that shade a proxy."""
SOCKETS = (
    ("Color", "INPUT", "Color"),
    *((name, "INPUT", "Float") for name in ("Distance", SHADE)),
    ("Surface", "OUTPUT", "Shader"),
)
REACH, SHADES = 8.0, 2.0
"""Distances, in radii of the user's object, up to which proxies shine, and up to which it shades
them. At 8, places in the light's picture are wrong by 7 degrees. At 2, the object covers a
fifteenth of the light."""
PARTS = "Near", "Far"
"""Vertex groups of the background: the part that may shine, and the part that only catches."""
FILE = "roigs_glb"
"""Custom property of a mesh: SHA-256 of its file."""
SAME_WAY, SAME_PLANE = 0.97, 0.05
"""Two planes count as one above this cosine between their normals, and below this distance as a
share of a side."""
SHADE_SAMPLES = 1
"""Rays per hit. Each path has its own, so one is enough for the mean."""
WHITE = (0.8, 0.8, 0.8, 1.0)
"""Albedo of the catcher; the ratio of light does not depend on it."""


def of_scene(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The proxies of a scene."""
    collection = stage_props(scene).collection
    items = collection.objects if collection is not None else ()
    return [item for item in items if object_props(item).kind == "PROXY"]


def lacking(scene: bpy.types.Scene) -> list[str]:
    """Return the names of boxes that have Gaussians but no mesh for a proxy."""
    boxes = {ownership.box_of(scene, i) for i in lookup.splats(scene) if object_props(i).roi}
    made = {ownership.box_of(scene, item) for item in box_surfaces.surfaces(scene)}
    return sorted({roi for _, _, roi in boxes - made})


def bring(scene: bpy.types.Scene, background: Path | None) -> list[bpy.types.Object]:
    """Make proxies of all meshes in the scene; older proxies are replaced.

    Args:
        scene: gets the proxies.
        background: file with the mesh outside the boxes; None if there is none.

    Raises:
        AddonError: the file is damaged.
    """
    stage.keep(scene, "proxies", "")
    old = [item for item in of_scene(scene) if object_props(item).level != "IMPORTED"]
    catches, reflects = _ways(scene)
    mesh, picture = _read(background) if background is not None else (None, b"")
    for item in old:
        for each in (*item.children, item):
            stage.delete_with_materials(each)
    made = [_of_box(scene, item) for item in box_surfaces.surfaces(scene)]
    if mesh is not None:
        made.append(_of_mesh(scene, mesh, picture))
    for item in made:
        _link(scene, item)
    stage_props(scene).catches, stage_props(scene).reflects = catches, reflects
    set_reach(scene, stage_props(scene).radius or usual_radius(scene))
    settle(scene)
    return made


def settle(scene: bpy.types.Scene) -> None:
    """Hide proxies in renders that cannot use them.

    A box that renders show as a mesh needs no proxy, because the mesh is lit itself. Render engines
    other than Cycles have no shadow catchers and would show all proxies.
    """
    for item in of_scene(scene):
        source, there = item.parent, scene.render.engine == shadow_pass.CYCLES
        if source is not None and object_props(source).kind == "SURFACE":
            gaussians = box_surfaces.gaussians_of(scene, source)
            shown = gaussians is not None and not gaussians.hide_render
            there = there and source.hide_render and shown
        for each in (item, *item.children):
            if each.hide_render == there:
                each.hide_render = not there


def _ways(scene: bpy.types.Scene) -> tuple[bool, bool]:
    """Return whether proxies catch and reflect: as set before; both if there are no proxies yet."""
    group = stage_props(scene)
    return (group.catches, group.reflects) if of_scene(scene) else (True, True)


def _of_box(scene: bpy.types.Scene, source: bpy.types.Object) -> bpy.types.Object:
    """Create a proxy from the mesh of a box; it moves with the mesh's object."""
    name = f"{object_props(source).roi} Proxy"
    item = bpy.data.objects.new(name, mesh_of(source))
    item.parent = source
    nodes = textured_meshes.image_nodes(next(iter(mesh_of(source).materials), None))
    _dress(scene, item, nodes[0].image if nodes else None)
    object_props(item).roi = object_props(source).roi
    return item


def _read(path: Path) -> tuple[bpy.types.Mesh, bytes]:
    """Read the engine's mesh in the COLMAP frame, and its picture."""
    try:
        read, digest = read_glb(path), files.sha256(path)
    except (OSError, ValueError) as error:
        raise AddonError(f"{error} Make the surface again.") from error
    mesh = textured_meshes.new_mesh(f"{BACKGROUND} Proxy", read)
    mesh[FILE] = digest
    return mesh, read.picture


def _of_mesh(scene: bpy.types.Scene, mesh: bpy.types.Mesh, picture: bytes) -> bpy.types.Object:
    """Create a proxy from the mesh of the background."""
    mesh.name = f"{BACKGROUND} Proxy"
    item = bpy.data.objects.new(mesh.name, mesh)
    item.parent = scene_props(scene).root
    image = textured_meshes.packed_picture(f"{BACKGROUND} Texture", picture)
    mesh.materials.append(None)
    _dress(scene, item, image)
    _part(scene, item)
    return item


def _part(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Give a proxy a second object for its far part, which only cameras, mirrors and glass see.

    Other rays then do not meet it. This is several times as fast as letting them through.
    """
    far = bpy.data.objects.new(f"{item.name} {PARTS[1]}", item.data)
    far.parent, far[FAR] = item, True
    far.is_shadow_catcher = far.hide_viewport = far.hide_select = True
    far.display_type = "WIRE"
    for own, slot in zip(far.material_slots, item.material_slots, strict=True):
        own.link, own.material = "OBJECT", slot.material
    for name in PARTS:
        item.vertex_groups.new(name=name)
    for each, name in zip((item, far), PARTS, strict=True):
        mask: Any = each.modifiers.new(name, "MASK")
        mask.vertex_group = name
    _link(scene, far)


def _sort(item: bpy.types.Object, middle: NDArray[np.float64], reach: float) -> None:
    """Divide a proxy into its two parts; faces that touch the sphere `reach` are near."""
    mesh = mesh_of(item)
    places = np.empty((len(mesh.vertices), 3), np.float32)
    corners = np.empty((len(mesh.polygons), 3), np.int32)
    mesh.vertices.foreach_get("co", places.ravel())
    mesh.loops.foreach_get("vertex_index", corners.ravel())
    matrix = lookup.matrix_world(item.parent)  # the item's own may be outdated until a redraw
    triangles = (places @ matrix[:3, :3].T + matrix[:3, 3])[corners]
    away = np.linalg.norm(triangles - middle, axis=-1).min(axis=1)
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1).max(axis=1)
    near = away - sides <= reach
    for name, faces in zip(PARTS, (near, ~near), strict=True):
        group = item.vertex_groups[name]
        group.remove(range(len(places)))
        group.add(np.unique(corners[faces]).tolist(), 1.0, "REPLACE")


def plane(scene: bpy.types.Scene, at: Vector, normal: Vector, size: float) -> bpy.types.Object:
    """Add a square proxy where there is no mesh; it shines as the world does from there.

    It replaces an earlier one in the same plane, and covers both areas.
    """
    stage.keep(scene, "proxies", "")
    catches, reflects = _ways(scene)
    size = drop_planes(scene, at, normal, size)
    mesh = bpy.data.meshes.new("Plane Proxy")
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * size / 2
    mesh.from_pydata(corners.tolist(), [], [(0, 1, 2, 3)])
    mesh.materials.append(None)
    item = bpy.data.objects.new(mesh.name, mesh)
    item.matrix_world = _standing(at, normal)
    _dress(scene, item, None)
    object_props(item).level = "IMPORTED"
    _link(scene, item)
    stage_props(scene).catches, stage_props(scene).reflects = catches, reflects
    return item


def drop_planes(scene: bpy.types.Scene, at: Vector, normal: Vector, size: float) -> float:
    """Remove planes that a new one replaces; return the side of a square that covers all."""
    for item in [i for i in of_scene(scene) if object_props(i).level == "IMPORTED"]:
        world, side = lookup.matrix_world(item), float(lookup.sides(item).max())
        away, up = at - Vector(world[:3, 3].tolist()), Vector(world[:3, 2].tolist()).normalized()
        if up @ normal > SAME_WAY and abs(away @ normal) < SAME_PLANE * max(size, side):
            size = max(size, side + 2 * away.length)
            stage.delete_with_materials(item)
    return size


def _standing(at: Vector, normal: Vector) -> Any:
    """Return the matrix of a place whose z axis is a normal."""
    matrix = normal.to_track_quat("Z", "Y").to_matrix().to_4x4()
    matrix.translation = at
    return matrix


def _link(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    stage.collection_of(scene).objects.link(item)


def _dress(scene: bpy.types.Scene, item: bpy.types.Object, picture: bpy.types.Image | None) -> None:
    """Make an object a proxy: set its kind, visibility and material."""
    object_props(item).kind = "PROXY"
    item.is_shadow_catcher = True
    item.hide_viewport = item.hide_select = True
    item.display_type = "WIRE"
    material = _material(item.name, picture, stage.empty_of(scene, "here"))
    for slot in item.material_slots:
        slot.link = "OBJECT"
        slot.material = material


def set_reach(scene: bpy.types.Scene, radius: float) -> None:
    """Make proxies emit light, and hide the world, near the place of the light's picture.

    Args:
        scene: of the proxies.
        radius: of the user's object there, in units of the world.
    """
    stage_props(scene).radius = radius
    here = stage.empty_of(scene, "here")
    frame = lookup.matrix_world(here.parent)
    here.scale = [REACH * radius / (transforms.scale_of(frame) or 1.0)] * 3
    middle = (frame @ (*here.location.to_tuple(), 1.0))[:3]
    for item in of_scene(scene):
        if any(child.get(FAR) for child in item.children):
            _sort(item, middle, REACH * radius)
    for nodes in _trees(scene):
        for node in (n for n in nodes if getattr(n, "node_tree", None) == _group()):
            node.inputs[SHADE].default_value = SHADES * radius


def usual_radius(scene: bpy.types.Scene) -> float:
    """Return the radius of the smallest box, as a typical object's; 1 without boxes and meshes.

    Without boxes, it uses their meshes: a file may show a run's results without the boxes.
    """
    worlds = map(lookup.matrix_world, lookup.rois(scene))
    boxes = [float(np.linalg.norm(world[:3, :3], axis=0).max()) for world in worlds]
    meshes = [float(lookup.sides(item).max()) / 2 for item in box_surfaces.surfaces(scene)]
    return min(boxes or meshes, default=1.0)


def use_light(scene: bpy.types.Scene, image: bpy.types.Image) -> None:
    """Make proxies without their own picture emit the light's picture."""
    for nodes in _trees(scene):
        for node in (n for n in nodes if n.bl_idname == "ShaderNodeTexEnvironment"):
            node.image = image


def _trees(scene: bpy.types.Scene) -> Iterator[Any]:
    """Yield the nodes of each proxy's materials."""
    for item in of_scene(scene):
        material: Any
        for material in [slot.material for slot in item.material_slots if slot.material]:
            yield material.node_tree.nodes


def _material(
    name: str, picture: bpy.types.Image | None, here: bpy.types.Object
) -> bpy.types.Material:
    """Create the material of a proxy."""
    material = textured_meshes.blank_material(name)
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    surface, output = nodes.new("ShaderNodeGroup"), nodes.new("ShaderNodeOutputMaterial")
    place, away = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeVectorMath")
    surface.node_tree, place.object, away.operation = _group(), here, "LENGTH"
    kind = "ShaderNodeTexImage" if picture is not None else "ShaderNodeTexEnvironment"
    texture = nodes.new(kind)
    texture.location = -300, 0
    link(texture.outputs["Color"], surface.inputs["Color"])
    if picture is not None:
        texture.image = picture
    else:
        link(place.outputs["Object"], texture.inputs["Vector"])
    link(place.outputs["Object"], away.inputs[0])
    link(away.outputs["Value"], surface.inputs["Distance"])
    link(surface.outputs[0], output.inputs["Surface"])
    # Proxies are large and dim, so rays find them. As lamps, each triangle would cost time.
    of_cycles = getattr(material, "cycles", None)
    if of_cycles is not None:
        of_cycles.emission_sampling = "NONE"
    place.location, away.location, output.location = (-500, -300), (-300, -300), (250, 0)
    made: bpy.types.Material = material
    return made


def _group() -> Any:
    """Return the node group of a proxy's surface.

    It catches for camera rays. For other rays it shines, or lets them through beyond its reach.
    Mirrors and glass see it at any distance, because the picture that they see has no lamps.
    """
    if (known := known_group(GROUP, "ShaderNodeTree", SOCKETS)) is not None:
        return known
    group: Any = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    for name, way, kind in SOCKETS:
        group.interface.new_socket(name, in_out=way, socket_type=f"NodeSocket{kind}")
    new, link = group.nodes.new, group.links.new
    start, end, rays = new("NodeGroupInput"), new("NodeGroupOutput"), new("ShaderNodeLightPath")
    catches, shines, clear = (
        new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "Emission", "BsdfTransparent")
    )
    shade = new("ShaderNodeAmbientOcclusion")
    mirrored, beyond, far = (new("ShaderNodeMath") for _ in range(3))
    mirrored.operation, beyond.operation, far.operation = "MAXIMUM", "GREATER_THAN", "GREATER_THAN"
    beyond.inputs[1].default_value = 1.0
    shade.samples = SHADE_SAMPLES
    others, whole = new("ShaderNodeMixShader"), new("ShaderNodeMixShader")
    catches.inputs["Color"].default_value = WHITE
    for source, target in (
        (start.outputs["Color"], shade.inputs["Color"]),
        (start.outputs[SHADE], shade.inputs["Distance"]),
        (shade.outputs["Color"], shines.inputs["Color"]),
        (rays.outputs["Is Glossy Ray"], mirrored.inputs[0]),
        (rays.outputs["Is Transmission Ray"], mirrored.inputs[1]),
        (start.outputs["Distance"], beyond.inputs[0]),
        (beyond.outputs[0], far.inputs[0]),
        (mirrored.outputs[0], far.inputs[1]),
        (far.outputs[0], others.inputs[0]),
        (shines.outputs[0], others.inputs[1]),
        (clear.outputs[0], others.inputs[2]),
        (rays.outputs["Is Camera Ray"], whole.inputs[0]),
        (others.outputs[0], whole.inputs[1]),
        (catches.outputs[0], whole.inputs[2]),
        (whole.outputs[0], end.inputs[0]),
    ):
        link(source, target)
    columns = (
        (start, rays),
        (mirrored, beyond, shade),
        (far,),
        (catches, shines, clear),
        (others,),
        (whole,),
        (end,),
    )
    for x, column in enumerate(columns):
        for y, node in enumerate(column):
            node.location = 220 * x, -220 * y
    return group
