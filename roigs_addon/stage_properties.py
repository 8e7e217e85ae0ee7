"""Properties of the stage, for the user's own objects in the captured scene."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty, PointerProperty, StringProperty

CLEAR = ("glossy", "transmission")
"""Those of mirrors and glass."""
FAR = "roigs_far"
"""Custom property of a proxy that is too far to shine."""
RAYS = ("diffuse", "glossy", "transmission", "volume_scatter", "shadow")
"""Of Cycles, besides the camera's: `visible_` of an object."""


def proxies_of(stage: RoigsStage) -> list[Any]:
    """Proxies and their far parts. The user may have put other objects beside them."""
    collection = stage.collection
    items = collection.objects if collection is not None else ()
    return [item for item in items if FAR in item or item.roigs.kind == "PROXY"]


def _catches(stage: RoigsStage) -> bool:
    return any(item.visible_camera for item in proxies_of(stage))


def _set_catches(stage: RoigsStage, on: bool) -> None:
    for item in proxies_of(stage):
        item.visible_camera = on


def _reflects(stage: RoigsStage) -> bool:
    return any(item.visible_glossy for item in proxies_of(stage))


def _set_reflects(stage: RoigsStage, on: bool) -> None:
    for item in proxies_of(stage):
        for name in RAYS:
            setattr(item, f"visible_{name}", on and (FAR not in item or name in CLEAR))


class RoigsStage(bpy.types.PropertyGroup):
    """Properties that make the user's objects look as if they stood in the captured scene."""

    before: StringProperty(
        description="Earlier settings of the scene, as JSON; empty: none changed"
    )
    collection: PointerProperty(
        type=bpy.types.Collection, description="The proxies of captured surfaces"
    )
    turn: PointerProperty(
        type=bpy.types.Object, description="Empty that turns the light with the captured scene"
    )
    here: PointerProperty(
        type=bpy.types.Object, description="Empty where the light's picture was taken"
    )
    radius: FloatProperty(description="Radius of the user's object there, in units of the world")
    world: PointerProperty(type=bpy.types.World, description="The world with the scene's light")
    world_before: PointerProperty(type=bpy.types.World, description="The user's world")
    catches: BoolProperty(
        name="Catch Shadows",
        get=_catches,
        set=_set_catches,
        description="Captured surfaces receive the shadows and the light of your objects (Cycles)",
    )
    reflects: BoolProperty(
        name="Reflections and Bounce",
        get=_reflects,
        set=_set_reflects,
        description="Your objects reflect captured surfaces and receive their light; these also "
        "block the light of the world (Cycles)",
    )


def stage_props(scene: bpy.types.Scene) -> RoigsStage:
    """The add-on's data of a scene for the user's own objects."""
    described: Any = scene  # Blender's stubs know nothing of what add-ons add
    stage: RoigsStage = described.roigs.stage
    return stage
