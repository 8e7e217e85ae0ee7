"""Prepares a scene for the user's own objects with light, proxies and passes, and undoes it.

Additions are in a separate collection and a separate world. Other settings are saved in the .blend
before they change, so that `remove` restores them.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import bpy
from mathutils import Vector

from ..blender import delete, is_local
from ..properties import SHOWN_AS, object_props
from ..shared import text
from ..stage_properties import stage_props
from . import compositor, display, lookup, shadow_pass

NATIVE = "shown "
"""Before a name of Gaussians, in what is remembered: how they were shown."""
WAYS = [way for way, _, _ in SHOWN_AS]
LAMP = "roigs_lamp"
"""Custom property of a lamp: whether it was part of what was captured."""
SETTINGS = {
    "film": "film_transparent",
    "compositing": "use_compositing",
    "persistent": "use_persistent_data",
}
"""Of renders: their names in what is remembered, and Blender's."""
COMPOSITOR = "compositor"
"""What was changed of it, in what is remembered."""
COLLECTION, TURN, HERE = "ROI-GS Stage", "ROI-GS Light", "ROI-GS Here"


def is_set(scene: bpy.types.Scene) -> bool:
    """Whether there is anything to remove."""
    stage = stage_props(scene)
    return bool(stage.before or stage.world or stage.collection)


def collection_of(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return the collection of all additions, created if there is none."""
    stage = stage_props(scene)
    if stage.collection is None:
        stage.collection = bpy.data.collections.new(COLLECTION)
    collection: bpy.types.Collection = stage.collection
    if collection.name not in scene.collection.children:
        scene.collection.children.link(collection)
    return collection


def empty_of(scene: bpy.types.Scene, which: str) -> bpy.types.Object:
    """Return the empty that turns the light (`turn`), or marks its picture's place (`here`)."""
    stage = stage_props(scene)
    item: bpy.types.Object | None = getattr(stage, which)
    if item is None:
        item = bpy.data.objects.new(TURN if which == "turn" else HERE, None)
        item.empty_display_type = "SPHERE"
        item.hide_viewport = item.hide_select = True
        setattr(stage, which, item)
    if item.name not in collection_of(scene).objects:
        collection_of(scene).objects.link(item)
    return item


def follow(scene: bpy.types.Scene, frame: bpy.types.Object | None, at: Vector) -> None:
    """Let the light turn with an object, and mark where its picture was taken.

    Args:
        scene: the lit scene.
        frame: the object in whose frame the picture is; None for the world.
        at: place of the picture, in the world. It moves with the frame.
    """
    turn, here = empty_of(scene, "turn"), empty_of(scene, "here")
    turn.constraints.clear()
    here.parent, here.location = frame, at
    if frame is not None:
        constraint: Any = turn.constraints.new("COPY_ROTATION")
        constraint.target = frame
        here.location = frame.matrix_world.inverted() @ at


def keep(scene: bpy.types.Scene, name: str, value: Any) -> None:
    """Save the earlier value of a setting, unless it is saved already."""
    stage = stage_props(scene)
    known = _before(scene)
    if name not in known:
        stage.before = json.dumps(known | {name: value})


def _before(scene: bpy.types.Scene) -> dict[str, Any]:
    try:
        known = text.parse_json((stage_props(scene).before or "{}").encode())
    except ValueError:
        return {}
    return known if isinstance(known, dict) else {}


def clear_film(scene: bpy.types.Scene) -> None:
    """Make the film transparent: the Gaussians are the background, not the world.

    With an opaque film, the world shows in pixels that a catcher or an object covers in part.
    """
    keep(scene, "film", scene.render.film_transparent)
    scene.render.film_transparent = True


def free_lamps(scene: bpy.types.Scene) -> None:
    """Let the user's lamps light captured surfaces, too.

    Blender treats a lamp as part of the captured scene unless its **Shadow Catcher** is off. A lamp
    is changed only once, so that the user may change it back.
    """
    item: Any
    for item in scene.objects:
        if item.type == "LIGHT" and item.is_editable and LAMP not in item:
            item[LAMP] = item.is_shadow_catcher
            item.is_shadow_catcher = False


def show_exactly(scene: bpy.types.Scene) -> None:
    """Let the engine draw objects that Blender shows as its own splats (5.3).

    Blender's splats take no shadow. A catcher in front of them would hide them, one behind them
    would catch nothing. They would also light objects that proxies light already.
    """
    for item in lookup.splats(scene):
        if display.is_native(item) and is_local(item):
            keep(scene, f"{NATIVE}{item.name}", object_props(item).shown_as)
            display.show_as(item, "EXACT")


def multiply(scene: bpy.types.Scene) -> None:
    """Have renders multiply the Gaussians by the shadows that proxies catch."""
    keep(scene, "compositing", scene.render.use_compositing)
    scene.render.use_compositing = True
    keep(scene, "persistent", scene.render.use_persistent_data)
    scene.render.use_persistent_data = True  # else each frame builds the proxies again
    clear_film(scene)
    show_exactly(scene)
    if (compositing := compositor.before(scene)) is not None:
        keep(scene, COMPOSITOR, compositing)
    compositor.link(scene)
    for layer in scene.view_layers:
        keep(scene, f"pass {layer.name}", shadow_pass.is_on(layer))
    shadow_pass.connect(scene)
    free_lamps(scene)


def remove(scene: bpy.types.Scene) -> None:
    """Remove all additions and restore all settings."""
    stage, before = stage_props(scene), _before(scene)
    shadow_pass.disconnect(scene)
    if isinstance(before.get(COMPOSITOR), dict):
        compositor.unlink(scene, before[COMPOSITOR])
    for name, setting in SETTINGS.items():
        if isinstance(before.get(name), bool):
            setattr(scene.render, setting, before[name])
    for layer in scene.view_layers:
        if (name := f"pass {layer.name}") in before:
            shadow_pass.switch(layer, on=bool(before[name]))
    for shown in lookup.splats(scene):
        way = before.get(f"{NATIVE}{shown.name}")
        if way in WAYS and object_props(shown).shown_as == "EXACT":
            display.show_as(shown, way)
    item: Any
    for item in scene.objects:
        if LAMP in item:
            item.is_shadow_catcher = bool(item[LAMP])
            del item[LAMP]
    _remove_world(scene)
    if stage.collection is not None:
        for item in list(stage.collection.objects):
            delete_with_materials(item)
        bpy.data.collections.remove(stage.collection)
    for name in ("before", "collection", "turn", "here", "radius", "world", "world_before"):
        stage.property_unset(name)


def _remove_world(scene: bpy.types.Scene) -> None:
    stage = stage_props(scene)
    own, users = stage.world, stage.world_before
    if own is None:
        return
    if scene.world == own:  # else the user has chosen another one since
        scene.world = users
    stage.world = stage.world_before = None
    remove_world(own)


def remove_world(own: bpy.types.World) -> None:
    """Delete a world of ours, and its pictures that nothing else uses."""
    images = {node.image for node in _nodes_of(own) if node.type == "TEX_ENVIRONMENT"} - {None}
    bpy.data.worlds.remove(own)
    bpy.data.batch_remove([image for image in images if not image.users])


def _nodes_of(owner: Any) -> list[Any]:
    """Return the nodes of a world or material; a user's own may have none."""
    tree = owner.node_tree
    return list(tree.nodes) if tree is not None else []


def delete_with_materials(item: bpy.types.Object) -> None:
    """Delete an object with its own materials and their pictures, if nothing else uses them."""
    materials = {slot.material for slot in item.material_slots if slot.material is not None}
    delete(item)
    pictures = set()
    for material in materials:
        if not material.users:
            pictures |= {n.image for n in _nodes_of(material) if getattr(n, "image", None)}
            bpy.data.materials.remove(material)
    with suppress(ReferenceError):
        bpy.data.batch_remove([each for each in pictures if not each.users])
