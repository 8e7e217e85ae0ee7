"""Step 5, Result: an object's Gaussians in the exposure of a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import StringProperty

from ..blender import registration, scene_of
from ..facts import run_facts
from ..properties import object_props
from ..scene import look
from .base import FRESH, available, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult


class ExposureOfPhoto(bpy.types.Operator):
    """Show the active Gaussians as bright as a photo. Training levels photos to one exposure"""

    bl_idname = "roigs.exposure_of_photo"
    bl_label = "Exposure of a Photo"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(description="Name of the photo", options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must be drawn as Gaussians."""
        return available(cls, "" if look.is_drawn(context) else "Select Gaussians first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Set the exposure of the object's look."""
        stops = run_facts.result(scene_of(context)).exposures.get(self.photo)
        if stops is None:
            return failed(self, f"The exposure of '{self.photo}' is unknown.")
        assert context.active_object is not None
        object_props(context.active_object).exposure = look.of_stops(stops)
        return {"FINISHED"}


register, unregister = registration(ExposureOfPhoto)
