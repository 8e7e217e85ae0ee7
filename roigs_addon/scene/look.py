"""Exposure and tint of an object's Gaussians."""

from __future__ import annotations

import bpy

from ..properties import object_props

Gains = tuple[float, float, float]
"""What red, green and blue are multiplied by, as sRGB values."""


AS_IT_IS: Gains = (1.0, 1.0, 1.0)


def gains(item: bpy.types.Object) -> Gains:
    """Return an object's gains; an evaluated object gives those of its frame."""
    props = object_props(item)
    brightness = 2.0**props.exposure
    red, green, blue = (brightness * share for share in props.tint)
    return red, green, blue
