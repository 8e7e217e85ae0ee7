"""Instances of Gaussian objects by geometry nodes or a collection, also a linked one.

Blender draws nothing for them. Each is drawn like a separate object, without being made real.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..blender import following, persistent
from ..geometry.frames import Matrix
from ..properties import object_props


@dataclass(frozen=True, kw_only=True, eq=False)
class Instance:
    """A Gaussian object in an additional place.

    Attributes:
        item: the object.
        instancer: the object that instances it.
        matrix: (4, 4) from the object's frame to the world.
    """

    item: bpy.types.Object
    instancer: bpy.types.Object
    matrix: Matrix


_known: dict[int, list[Instance]] = {}
"""View layer (address) -> its instances, until anything changes: scenes have thousands."""


def instances(depsgraph: bpy.types.Depsgraph) -> list[Instance]:
    """Return the instances that an evaluated scene shows as Gaussians.

    Blender lists an object of several kinds of geometry more than once.
    """
    found: dict[tuple[int, int, bytes], Instance] = {}
    for each in depsgraph.object_instances:
        if not each.is_instance or each.object is None or each.parent is None:
            continue
        if each.object.type != "MESH":  # an object's own Blender splats are listed, too
            continue
        item, instancer = each.object.original, each.parent.original
        if item is None or instancer in (None, item) or not is_drawn(item):
            continue
        matrix = np.array(each.matrix_world, np.float64)
        if np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix[:3, :3]) == 3:
            key = item.session_uid, instancer.session_uid, matrix.tobytes()
            found[key] = Instance(item=item, instancer=instancer, matrix=matrix)
    return list(found.values())


def in_view(layer: bpy.types.ViewLayer) -> list[Instance]:
    """Return the instances of a view layer at its last evaluation."""
    key = layer.as_pointer()
    if key not in _known:
        depsgraph = layer.depsgraph if any(map(_may_instance, layer.objects)) else None
        _known[key] = instances(depsgraph) if depsgraph is not None else []
    return _known[key]


def in_collections(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    """Objects of the collections that are instanced in a scene, such as linked ones."""
    placed = (item.instance_collection for item in scene.objects if item.type == "EMPTY")
    for collection in {collection for collection in placed if collection is not None}:
        yield from collection.all_objects


def is_drawn(item: bpy.types.Object) -> bool:
    """Whether an object is drawn as Gaussians where it is shown."""
    props = object_props(item)
    drawn = props.kind == "SPLATS" and props.level != "PREVIEW"
    return drawn and bool(props.ply) and props.shown_as != "POINTS"


def _may_instance(item: bpy.types.Object) -> bool:
    if item.instance_type != "NONE" or item.particle_systems:
        return True
    return object_props(item).kind == "NONE" and any(m.type == "NODES" for m in item.modifiers)


@persistent
def _on_change(*_: object) -> None:
    _known.clear()


_follow, _leave = following(
    *((event, _on_change) for event in ("depsgraph_update_post", "frame_change_post")),
    *((event, _on_change) for event in ("undo_post", "redo_post", "load_pre", "load_post")),
)


def register() -> None:
    """Follow changes."""
    _follow()


def unregister() -> None:
    """Stop following changes."""
    _leave()
    _known.clear()
