"""Panoramic cameras of Cycles: the rays of their pixels."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..geometry import panorama
from .cameras import render_size

KINDS = {"EQUIRECTANGULAR", "FISHEYE_EQUIDISTANT", "FISHEYE_EQUISOLID"}


def is_drawn(data: bpy.types.Camera, scene: bpy.types.Scene) -> bool:
    """Whether the engine can draw for a panoramic camera, which only Cycles has."""
    kind = _setting(data, "panorama_type") if data.type == "PANO" else ""
    return str(scene.render.engine) == "CYCLES" and kind in KINDS


def rays(
    data: bpy.types.Camera, render: bpy.types.RenderSettings, part: tuple[int, int, int, int]
) -> panorama.Rays:
    """(H, W, 3) directions in the camera's frame, OpenCV axes, of a part of the picture.

    Args:
        data: a camera that `is_drawn`.
        render: gives the picture's size.
        part: left, top, width and height, pixels.
    """
    whole = render_size(render)
    left, top, width, height = part
    u = (left + np.arange(width)[None] + 0.5) / whole[0] + data.shift_x
    v = 1 - (top + np.arange(height)[:, None] + 0.5) / whole[1] + data.shift_y
    kind = _setting(data, "panorama_type")
    if kind == "EQUIRECTANGULAR":
        ends = [
            (_setting(data, f"{name}_min"), _setting(data, f"{name}_max"))
            for name in ("longitude", "latitude")
        ]
        return panorama.equirectangular(u, v, *ends)
    angle = _setting(data, "fisheye_fov")
    if kind == "FISHEYE_EQUIDISTANT":
        return panorama.equidistant(u, v, angle)
    return panorama.equisolid(u, v, angle, _setting(data, "fisheye_lens"), _sensor(data, *whole))


def density(data: bpy.types.Camera, render: bpy.types.RenderSettings) -> float:
    """Return pixels per radian, roughly the largest in the picture."""
    width, height = render_size(render)
    kind = _setting(data, "panorama_type")
    if kind == "EQUIRECTANGULAR":
        spans = (
            abs(_setting(data, f"{name}_max") - _setting(data, f"{name}_min"))
            for name in ("longitude", "latitude")
        )
        return float(max(a / max(b, 1e-6) for a, b in zip((width, height), spans, strict=True)))
    if kind == "FISHEYE_EQUIDISTANT":
        return float(max(width, height) / _setting(data, "fisheye_fov"))
    lens, sensor = _setting(data, "fisheye_lens"), _sensor(data, width, height)
    return float(max(width / sensor[0], height / sensor[1]) * lens)


def _sensor(data: bpy.types.Camera, width: int, height: int) -> tuple[float, float]:
    """Return width and height of the part of the sensor that a picture shows, in mm."""
    fit = data.sensor_fit
    if fit == "VERTICAL" or (fit == "AUTO" and width < height):
        size = data.sensor_height if fit == "VERTICAL" else data.sensor_width
        return size * width / height, size
    return data.sensor_width, data.sensor_width * height / width


def _setting(data: Any, name: str) -> Any:
    """Return a setting of the camera; before Blender 4.5, Cycles' settings have it."""
    return getattr(data, name) if hasattr(data, name) else getattr(data.cycles, name)
