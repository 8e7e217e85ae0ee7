"""Step 5, Result: select and delete Gaussians by boxes, opacity and size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty
from numpy.typing import NDArray

from ..blender import leave_edit_mode, registration, scene_of
from ..errors import AddonError
from ..scene import lookup, point_edits
from ..shared import text
from ..viewport import chosen
from .base import FRESH, NO_BOX, available, failed, tell

if TYPE_CHECKING:
    from ..blender import OperatorResult

Mask = NDArray[np.bool_]

ACTIONS = (
    ("SELECT", "Select", "Mark them, so that you can check them first"),
    ("DELETE", "Delete", "Delete them; undo restores them"),
)


def act(
    items: dict[bpy.types.Object, Mask],
    action: str,
    *,
    extend: bool = False,
    what: str = "Gaussian",
) -> str:
    """Select or delete points of objects; returns a line that says how many.

    Args:
        items: which points of each object.
        action: of `ACTIONS`.
        extend: keep what is selected already.
        what: a word for one of them.

    Raises:
        AddonError: they cannot be deleted.
    """
    whole = sum(len(mask) for mask in items.values())
    if action == "DELETE":
        count = sum(point_edits.remove(item, mask) for item, mask in items.items())
        chosen.show(())
        return _in_words("Deleted", count, whole, what)
    count = sum(point_edits.choose(item, mask, extend=extend) for item, mask in items.items())
    chosen.show(items)
    return _in_words("Selected", count, whole, what)


def _in_words(done: str, count: int, whole: int, what: str) -> str:
    """'Deleted 12 floaters of 3,456'."""
    return f"{done} {text.counted(count, what)} of {whole:,}"


class CleanUpTool(bpy.types.Operator):
    """Base of the operators that choose Gaussians by a rule."""

    action: EnumProperty(name="Action", items=ACTIONS, options=FRESH)
    extend: BoolProperty(name="Extend", description="Keep the earlier selection", options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians."""
        return available(cls, "" if point_edits.targets(context) else point_edits.NONE)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Find them, then select or delete them."""
        try:
            leave_edit_mode(lookup.splats(scene_of(context)))
            items = point_edits.checked_targets(context)
            found = {item: self.mask(item, context) for item in items}
            said = act(found, self.action, extend=self.extend)
        except AddonError as error:
            return failed(self, error)
        tell(self, "INFO", said)
        return {"FINISHED"}

    def mask(self, item: bpy.types.Object, context: bpy.types.Context) -> Mask:
        """(N,) which points of an object; raises AddonError."""
        raise NotImplementedError


class ChooseByBox(CleanUpTool):
    """Select or delete Gaussians inside or outside the boxes. Works on the selected Gaussian \
objects, otherwise on all visible ones"""

    bl_idname = "roigs.choose_by_box"
    bl_label = "Gaussians by Box"
    bl_options = {"REGISTER", "UNDO"}

    where: EnumProperty(
        name="Where",
        items=[
            ("OUTSIDE", "Outside All Boxes", "Gaussians with their centre in no box"),
            ("INSIDE", "Inside the Active Box", "Gaussians with their centre in the active box"),
        ],
        options=FRESH,
    )

    def mask(self, item: bpy.types.Object, context: bpy.types.Context) -> Mask:
        """By their centres."""
        scene, active = scene_of(context), lookup.active_roi(context)
        if active is None:
            raise AddonError(f"{NO_BOX}.")
        if self.where == "INSIDE":
            return point_edits.inside(item, active, scene)
        boxes = [point_edits.inside(item, roi, scene) for roi in lookup.rois(scene)]
        return np.asarray(~np.any(boxes, axis=0))


class ChooseByLook(CleanUpTool):
    """Select or delete faint or large Gaussians. Works on the selected Gaussian objects, \
otherwise on all visible ones"""

    bl_idname = "roigs.choose_by_look"
    bl_label = "Faint or Large Gaussians"
    bl_options = {"REGISTER", "UNDO"}

    opacity: FloatProperty(
        name="Opacity Below",
        description="Select Gaussians below this opacity; 0: none",
        default=0.05,
        min=0.0,
        max=1.0,
        options=FRESH,
    )
    size: FloatProperty(
        name="Size Above",
        description="Select Gaussians with a longer standard deviation, in world units; 0: none",
        default=0.0,
        min=0.0,
        subtype="DISTANCE",
        options=FRESH,
    )

    def mask(self, item: bpy.types.Object, context: bpy.types.Context) -> Mask:
        """By either of them."""
        faint = point_edits.opacities(item) < self.opacity
        large = point_edits.scales(item).max(axis=1) > self.size if self.size else False
        return np.asarray(faint | large)


class DeleteChosen(bpy.types.Operator):
    """Delete the selected Gaussians. Undo restores them"""

    bl_idname = "roigs.delete_chosen"
    bl_label = "Delete Selected"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Delete what is marked, also of objects that are not selected now."""
        try:
            leave_edit_mode(lookup.splats(scene_of(context)))
            items = marked(context)
            if not point_edits.count_chosen(items):
                raise AddonError("No Gaussians are selected. Use one of the tools first.")
            said = act({item: point_edits.chosen(item) for item in items}, "DELETE")
        except AddonError as error:
            return failed(self, error)
        tell(self, "INFO", said)
        return {"FINISHED"}


class ForgetChosen(bpy.types.Operator):
    """Deselect all Gaussians"""

    bl_idname = "roigs.forget_chosen"
    bl_label = "Select None"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Deselect what is marked."""
        leave_edit_mode(lookup.splats(scene_of(context)))
        for item in marked(context):
            point_edits.choose(item, np.zeros_like(point_edits.chosen(item)))
        chosen.show(())
        return {"FINISHED"}


def marked(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The objects whose selected points are marked; of those that share their points, one."""
    return point_edits.distinct(i for i in lookup.splats(scene_of(context)) if chosen.are_shown(i))


register, unregister = registration(ChooseByBox, ChooseByLook, DeleteChosen, ForgetChosen)
