"""Step 3, Cameras: masks of a box's object, made by the engine from strokes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import bpy
from bpy.props import BoolProperty, IntProperty

from ..blender import registration, scene_of
from ..engine.python import FOR_MASKS
from ..errors import AddonError
from ..jobs import masks_job, run_folders
from ..jobs.spec import JobSpec
from ..properties import scene_props
from ..scene import lookup, masks, scribbles
from ..shared import EngineError, mask_record, text
from .base import FRESH, NO_BOX, EngineOperator, available, box_problem, failed, model_problem

if TYPE_CHECKING:
    from ..blender import OperatorResult


CHANGED = "Make masks of the box's object from new or changed strokes. Your own masks are kept"
ALL_ANEW = (
    "Recreate all masks, so that corrections on one photo help the others. Your own masks are kept"
)


class MakeMasks(EngineOperator):
    """Make masks of the box's object from the strokes. Your own masks are kept"""

    bl_idname = "roigs.make_masks"
    bl_label = "Make Masks"

    anew: BoolProperty(
        name="All Anew",
        description="Recreate all masks, so that corrections on one photo help the others",
        options=FRESH,
    )

    @classmethod
    def description(
        cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties
    ) -> str:
        """The tooltip."""
        return ALL_ANEW if cast(Any, properties).anew else CHANGED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model, a box with strokes, and an idle engine."""
        roi = lookup.active_roi(context)
        no_strokes = "" if roi is None or scribbles.photos(roi) else masks_job.DRAW_FIRST
        return available(cls, model_problem(context) or box_problem(context) or no_strokes)

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """OpenCV cuts the photos."""
        return FOR_MASKS

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make them beside the photos."""
        roi, scene = lookup.active_roi(context), scene_of(context)
        if roi is None:
            raise AddonError(f"{NO_BOX}.")
        scene_props(scene).show_masks = True
        return masks_job.spec(scene, roi, anew=self.anew)


class StepMask(bpy.types.Operator):
    """Go to the next or previous photo with a mask or strokes for the active box"""

    bl_idname = "roigs.step_mask"
    bl_label = "Next Mask"
    bl_options = {"REGISTER", "UNDO"}

    step: IntProperty(description="Number of photos to move", default=1, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Look through the photo's camera, with its mask."""
        roi, scene = lookup.active_roi(context), scene_of(context)
        if roi is None:
            return failed(self, f"{NO_BOX}.")
        names = masks.photos(scene, run_folders.run_folder(scene), roi)
        if not names:
            return failed(self, f"'{roi.name}' has no masks yet.")
        photo = masks.photo_at_hand(context)
        at = names.index(photo.name) + self.step if photo and photo.name in names else 0
        scene_props(scene).show_masks = True
        operators: Any = bpy.ops
        operators.roigs.look_through(photo=names[at % len(names)])
        return {"FINISHED"}


class RemoveMasks(bpy.types.Operator):
    """Delete the active box's masks made from strokes. The strokes stay, and so do masks that you \
made or changed"""

    bl_idname = "roigs.remove_masks"
    bl_label = "Remove Masks"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box, and the engine must be idle."""
        return available(cls, model_problem(context) or box_problem(context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask first: files cannot be undone."""
        assert context.window_manager is not None
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Delete the files."""
        roi, scene = lookup.active_roi(context), scene_of(context)
        if roi is None:
            return failed(self, f"{NO_BOX}.")
        roots = masks.folders(scene, run_folders.run_folder(scene))
        try:
            count = sum(mask_record.remove_masks(masks.of_box(root, roi)) for root in roots)
        except EngineError as error:
            return failed(self, str(error))
        self.report({"INFO"}, f"Removed {text.counted(count, 'mask')}.")
        return {"FINISHED"}


register, unregister = registration(MakeMasks, StepMask, RemoveMasks)
