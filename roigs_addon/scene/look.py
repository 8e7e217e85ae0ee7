"""Exposure and tint of an object's Gaussians."""

from __future__ import annotations

import bpy

from ..properties import object_props

Gains = tuple[float, float, float]
"""Factors of red, green and blue, applied to sRGB values."""


AS_IT_IS: Gains = (1.0, 1.0, 1.0)
GAMMA = 2.2
"""A stop more light multiplies an sRGB value by about 2^(1/2.2)."""


def is_drawn(context: bpy.types.Context) -> bool:
    """Whether the active object is drawn as Gaussians."""
    item = context.active_object
    if item is None or object_props(item).kind != "SPLATS":
        return False
    return bool(object_props(item).shown_as != "POINTS")


def of_stops(stops: float) -> float:
    """The exposure of a look that changes colours about as much as stops of light."""
    return stops / GAMMA


def gains(item: bpy.types.Object) -> Gains:
    """Return an object's gains; an evaluated object gives those of its frame."""
    props = object_props(item)
    brightness = 2.0**props.exposure
    red, green, blue = (brightness * share for share in props.tint)
    return red, green, blue
