"""The scene's active camera as a camera path for the engine (docs/files.md)."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ..errors import AddonError
from ..properties import scene_props
from . import cameras


def camera_path(scene: bpy.types.Scene, *, animation: bool) -> list[dict[str, Any]]:
    """The active camera at the current frame, or at each frame of the scene's range.

    Raises:
        AddonError: it is not a perspective camera.
    """
    now = scene.frame_current
    numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    path: list[dict[str, Any]] = []
    try:
        for number in numbers if animation else [now]:
            if number != scene.frame_current:
                scene.frame_set(number)
            photo = cameras.scene_camera(scene, scene_props(scene).root)
            if photo is None:
                raise AddonError("The active camera is not a perspective camera. Set its type.")
            path.append(json.loads(photo.to_json()))
    finally:
        if scene.frame_current != now:
            scene.frame_set(now)
    return path
