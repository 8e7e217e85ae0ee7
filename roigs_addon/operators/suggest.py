"""Step 3, Cameras: check the photos, and suggest the next ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import bpy
from bpy.props import StringProperty

from ..blender import registration, scene_of, view_3d_of, view_layer_of
from ..errors import AddonError
from ..jobs import suggest_job, undo
from ..jobs.spec import JobSpec
from ..scene import cameras, lookup, suggestions
from .base import FRESH, EngineOperator, available, engine_problem, failed, tell

if TYPE_CHECKING:
    from ..blender import OperatorResult

NONE = "Click Suggest Photos first"


class _Guidance(EngineOperator):
    """Asks the engine what the photos of all boxes show, and where to take the next ones."""

    shows: ClassVar[bool]
    """Whether cameras are put at these places."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model, a box, and an idle engine."""
        return available(cls, engine_problem(context))

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """A trained model needs more than points."""
        return suggest_job.packages(scene_of(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """For all boxes."""
        scene = scene_of(context)
        return suggest_job.spec(scene, lookup.rois(scene), show=self.shows)


class CheckPhotos(_Guidance):
    """Find out how well the photos cover each box, and which of them are blurred, out of focus, \
too bright or dark, or misplaced. Nothing is excluded without a click"""

    bl_idname = "roigs.check_photos"
    bl_label = "Check Photos"
    shows = False


class SuggestPhotos(_Guidance):
    """Show where to take the next photos: the most informative for each box, from reachable \
places. After Check Photos, they are shown at once"""

    bl_idname = "roigs.suggest_photos"
    bl_label = "Suggest Photos"
    shows = True

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Show what the last check found, or ask the engine and wait."""
        return self._at_once(context) or EngineOperator.execute(self, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Show what the last check found, or ask the engine, and leave the window free."""
        return self._at_once(context) or EngineOperator.invoke(self, context, event)

    def _at_once(self, context: bpy.types.Context) -> OperatorResult | None:
        """None: the engine must be asked; so it is if suggestions are shown already."""
        scene = scene_of(context)
        if suggestions.are_there(scene):
            return None
        try:
            listed = suggest_job.kept(scene, lookup.rois(scene))
            if listed is None:
                return None
            count = suggestions.show(scene, listed)
        except AddonError as error:
            return failed(self, error)
        undo.push(self.bl_label)
        tell(self, "INFO", suggest_job.in_words(count))
        return {"FINISHED"}


class RemoveSuggestions(bpy.types.Operator):
    """Remove the suggested photos' cameras from the scene"""

    bl_idname = "roigs.remove_suggestions"
    bl_label = "Remove Suggestions"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be some."""
        return available(cls, "" if suggestions.are_there(scene_of(context)) else NONE)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove them all."""
        suggestions.remove(scene_of(context))
        return {"FINISHED"}


class OpenSuggestions(bpy.types.Operator):
    """Open the suggestions in the browser, to print or for the phone: a plan, pictures and \
descriptions"""

    bl_idname = "roigs.open_suggestions"
    bl_label = "Open Page"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The page must be there."""
        return available(cls, "" if suggest_job.page(scene_of(context)) else NONE)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Open it."""
        page = suggest_job.page(scene_of(context))
        if page is None:
            return failed(self, f"{NONE}.")
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


class LookThroughSuggestion(bpy.types.Operator):
    """Look through the suggested photo's camera, with a preview of the photo as background"""

    bl_idname = "roigs.look_through_suggestion"
    bl_label = "Look Through Suggestion"
    bl_options = {"REGISTER", "UNDO"}

    camera: StringProperty(description="Name of the camera's object", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Make the camera active and look through it."""
        scene = scene_of(context)
        item = next((s for s in lookup.of_kind(scene, "SHOT") if s.name == self.camera), None)
        if item is None:
            return failed(self, f"There is no such suggestion. {NONE}.")
        cameras.activate(scene, item)
        if item.name in view_layer_of(context).objects:
            view_layer_of(context).objects.active = item
        view = view_3d_of(context)
        if view is not None and view.region_3d is not None:
            view.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}


register, unregister = registration(
    CheckPhotos, SuggestPhotos, RemoveSuggestions, OpenSuggestions, LookThroughSuggestion
)
