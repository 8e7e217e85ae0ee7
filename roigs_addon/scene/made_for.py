"""Whether the shown Gaussians were made for the renderer that draws them."""

from __future__ import annotations

import bpy

from ..properties import object_props, scene_props
from ..shared import targets
from . import display, lookup, native_splats, ownership
from .splat_attributes import marked_target


def mismatch(scene: bpy.types.Scene) -> tuple[targets.Target, targets.Target] | None:
    """Return the result's target and the renderer in use or set; None if they are the same.

    Blender draws its own splats with its render engine; the add-on draws objects for their own
    target.
    """
    blenders = (i for i in scene.objects if native_splats.are_in(i) or _is_native(i))
    data = next((item.data for item in blenders if item.visible_get()), None)
    wanted = targets.CYCLES if str(scene.render.engine) == "CYCLES" else targets.EEVEE
    if data is None:
        own = ownership.own_splats(scene)
        shown = (item for item in own if object_props(item).level == "RESULT")
        data = next((item.data for item in shown), None)
        # A .blend of another version may have another target.
        wanted = targets.TARGETS.get(scene_props(scene).made_for, targets.VIEWERS)
    if not isinstance(data, (bpy.types.Mesh, bpy.types.PointCloud)):
        return None
    made = marked_target(data)
    return None if made == wanted else (made, wanted)


def _is_native(item: bpy.types.Object) -> bool:
    return bool(object_props(item).kind == "SPLATS") and display.is_native(item)


def in_other_light(scene: bpy.types.Scene) -> tuple[str, targets.Target] | None:
    """Return an object drawn in another light than it was made for, and its target; None if none.

    Gaussians that are seen together are drawn in the light of the majority.
    """
    found: dict[bool, list[tuple[int, str, targets.Target]]] = {False: [], True: []}
    for item in lookup.splats(scene):
        mesh = item.data
        if display.is_native(item):
            continue
        if isinstance(mesh, bpy.types.Mesh) and not item.hide_render and item.visible_get():
            target = marked_target(mesh)
            found[target.linear_light].append((len(mesh.vertices), item.name, target))
    if not (found[False] and found[True]):
        return None
    fewer = min(found.values(), key=lambda items: sum(count for count, _, _ in items))
    return max(fewer)[1:]
