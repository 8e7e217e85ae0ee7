"""Step 3, Cameras: the photos that train each box, selected by the engine or by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..blender import registration, scene_of
from ..errors import AddonError
from ..jobs import select_job
from ..jobs.spec import JobSpec
from ..properties import object_props
from ..scene import exclusions, lookup, selections
from ..shared import text
from .base import FRESH, NO_BOX, EngineOperator, available, box_problem, engine_problem, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult

SELECT_FIRST = "Select cameras first."


class SelectCameras(EngineOperator):
    """Select the best photos of each box. Training does this by itself. With All boxes together, \
the default, boxes train on all photos that show them, and the selection hardly matters. With One \
by one (paper), a box trains on its selected photos alone"""

    bl_idname = "roigs.select_cameras"
    bl_label = "Select Cameras"

    active_only: BoolProperty(name="Active Box Only", default=False, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model, a box, and an idle engine."""
        return available(cls, engine_problem(context))

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Some methods need more than others."""
        return select_job.packages(scene_of(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Select into the run folder, then into the boxes."""
        active, scene = lookup.active_roi(context), scene_of(context)
        boxes = [active] if self.active_only and active is not None else lookup.rois(scene)
        return select_job.spec(scene, boxes)


class EditSelection(bpy.types.Operator):
    """Change the active box's list of photos"""

    bl_idname = "roigs.edit_selection"
    bl_label = "Edit Photos"
    bl_options = {"REGISTER", "UNDO"}

    action: EnumProperty(
        items=(
            ("ADD", "Add", "Add the selected cameras"),
            ("REMOVE", "Remove", "Remove the photo from the list"),
            ("UP", "Up", "Move the photo up"),
            ("DOWN", "Down", "Move the photo down"),
            ("CLEAR", "Clear", "Clear the list; the engine then selects"),
        ),
        options=FRESH,
    )
    photo: StringProperty(
        description="For ADD: name of the photo; empty: those of the selected cameras",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Edit the list; cameras get their colours."""
        roi = lookup.active_roi(context)
        if roi is None:
            return failed(self, f"{NO_BOX}.")
        props = object_props(roi)
        chosen, at = props.selection, props.selection_index
        match self.action:
            case "ADD":
                selections.add_photos(roi, [self.photo] if self.photo else _selected(context))
            case "REMOVE" if at < len(chosen):
                chosen.remove(at)
                props.selection_index = max(min(at, len(chosen) - 1), 0)
            case "UP" if 0 < at < len(chosen):
                chosen.move(at, at - 1)
                props.selection_index = at - 1
            case "DOWN" if at < len(chosen) - 1:
                chosen.move(at, at + 1)
                props.selection_index = at + 1
            case "CLEAR":
                chosen.clear()
                props.selected_box = ""
        selections.mark_chosen(scene_of(context))
        return {"FINISHED"}


class ExcludePhotos(bpy.types.Operator):
    """Exclude photos from selection and training; boxes keep them in their lists"""

    bl_idname = "roigs.exclude_photos"
    bl_label = "Exclude Photos"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(
        description="Name of the photo; empty: those of the selected cameras", options=FRESH
    )
    reason: StringProperty(description="Why, for the tooltip", options=FRESH)

    @classmethod
    def description(cls, _: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """With the reason, if the button has one; else Blender takes the docstring."""
        reason = text.printable(str(getattr(properties, "reason", "")))
        return f"Exclude this photo from selection and training. It is {reason}" if reason else ""

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remember their names in the scene; their cameras become red."""
        scene = scene_of(context)
        if self.photo and self.photo not in lookup.cameras(scene):
            return failed(self, f"There is no photo '{self.photo}'.")
        photos = [self.photo] if self.photo else _selected(context)
        if not photos:
            return failed(self, SELECT_FIRST)
        exclusions.exclude(scene, photos)
        return {"FINISHED"}


class IncludePhotos(bpy.types.Operator):
    """Use excluded photos again, and restore deleted cameras"""

    bl_idname = "roigs.include_photos"
    bl_label = "Include Photos"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(
        description="Name of the photo; empty: those of the selected cameras", options=FRESH
    )
    every: BoolProperty(name="All", description="All excluded photos", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Forget their names."""
        scene = scene_of(context)
        photos = [self.photo] if self.photo else _selected(context)
        photos = exclusions.excluded(scene) if self.every else photos
        if not photos:
            return failed(self, SELECT_FIRST)
        try:
            exclusions.include(scene, photos)
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


def _selected(context: bpy.types.Context) -> list[str]:
    return [photo.name for photo in selections.photos_of(context.selected_objects)]


register, unregister = registration(SelectCameras, EditSelection, ExcludePhotos, IncludePhotos)
