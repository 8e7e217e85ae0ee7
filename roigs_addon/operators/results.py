"""Step 5, Result: import the Gaussians, choose what to show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..blender import (
    following,
    leave_edit_mode,
    persistent,
    registration,
    scene_of,
    select_only,
    view_layer_of,
)
from ..engine import earlier_results
from ..errors import AddonError
from ..facts import caches, run_facts
from ..jobs import current, run_folders
from ..properties import SHOWN_AS, object_props
from ..scene import (
    box_surfaces,
    carried,
    compared,
    compositor,
    detail,
    edits,
    lookup,
    ownership,
    splats,
)
from ..windows import redraw
from .base import FRESH, NO_RESULT, available, failed, tell

if TYPE_CHECKING:
    from ..blender import OperatorResult

NO_GAUSSIANS = "This scene has no Gaussians"


def to_get_some(scene: bpy.types.Scene) -> str:
    """What to do in a scene without Gaussians."""
    first = "Load the results" if _can_load(scene) else "Train to get Gaussians"
    return f"{first}, or import some"


def _can_load(scene: bpy.types.Scene) -> bool:
    """Whether a training is finished."""
    return bool(run_facts.run(scene).result or run_facts.earlier(scene))


class LoadResults(bpy.types.Operator):
    """Import the trained Gaussians from the run folder into the scene"""

    bl_idname = "roigs.load_results"
    bl_label = "Load Results"
    bl_options = {"REGISTER", "UNDO"}

    earlier: StringProperty(
        description="Name of an earlier result's folder; empty: the last finished one",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training."""
        return available(cls, "" if _can_load(scene_of(context)) else NO_RESULT)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Make an object for the background, and two for each box."""
        scene, shown = scene_of(context), ownership.own_splats(scene_of(context))
        leave_edit_mode(shown)  # in it, what was edited cannot be told
        try:
            folder, edited = self._folder(scene), any(map(edits.is_edited, shown))
            if self.earlier and edited and compared.shown_result(scene) != folder:
                compared.switch(scene, folder)  # edits of the one that is shown wait for it
            else:
                splats.show_results(scene, folder)
        except AddonError as error:
            return failed(self, error)
        for text in box_surfaces.load(scene, folder):
            tell(self, "WARNING", text)
        caches.forget()
        return {"FINISHED"}

    def _folder(self, scene: bpy.types.Scene) -> Path:
        kept = {result.folder.name: result.folder for result in run_facts.earlier(scene)}
        if self.earlier:
            if self.earlier not in kept:
                raise AddonError("This result is gone.")
            return kept[self.earlier]
        if run_facts.run(scene).result or not kept:
            return run_folders.run_folder(scene)
        return next(iter(kept.values()))


class DeleteResult(bpy.types.Operator):
    """Delete this earlier result's files"""

    bl_idname = "roigs.delete_result"
    bl_label = "Delete Result"

    earlier: StringProperty(description="Name of its folder", options=FRESH)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask first."""
        assert context.window_manager is not None
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Delete the files."""
        try:
            earlier_results.delete(run_folders.run_folder(scene_of(context)), self.earlier)
        except AddonError as error:
            return failed(self, error)
        caches.forget()
        return {"FINISHED"}


class SetDetail(bpy.types.Operator):
    """Show this box with levels of detail, as the full result, or as after the first pass"""

    bl_idname = "roigs.set_detail"
    bl_label = "Auto, Result or First Pass"
    bl_options = {"REGISTER", "UNDO"}

    roi: StringProperty(description="Name of the box", options=FRESH)
    name: StringProperty(description="Name of an object; empty: all of the box", options=FRESH)
    fine: BoolProperty(default=True, options=FRESH)
    auto: BoolProperty(
        description="Fewer Gaussians from far away; otherwise all of them", options=FRESH
    )

    @classmethod
    def description(
        cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties
    ) -> str:
        """The tooltip."""
        if not properties.fine:
            return "Show this box as after the first pass over the whole scene"
        if properties.auto:
            return "Draw fewer Gaussians from far away: levels of detail"
        return "Always draw all Gaussians"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Hide one, show the other."""
        scene = scene_of(context)
        try:
            for item in lookup.splats(scene):
                if object_props(item).level == "RESULT" and item.name_full == self.name:
                    detail.set_auto(scene, item, self.auto)
            for pair in detail.pairs(scene):
                items = [item for item in (pair.fine, pair.coarse) if item is not None]
                of_box = any(object_props(item).roi == self.roi for item in items)
                named = any(item.name_full == self.name for item in items)
                if named if self.name else of_box:
                    detail.set_detail(scene, pair, self.fine, auto=self.auto)
        except AddonError as error:
            return failed(self, error)
        _select_shown(context)
        redraw()  # Blender does not see that another level is drawn
        return {"FINISHED"}


def _select_shown(context: bpy.types.Context) -> None:
    """Keep what the user works on at hand: the other object of its pair, if that is shown now."""
    active = view_layer_of(context).objects.active  # the context has no hidden one
    if active is None or not object_props(active).off:
        return
    pairs = detail.pairs(scene_of(context))
    pair = next((pair for pair in pairs if active in (pair.fine, pair.coarse)), None)
    if pair is not None and pair.shown is not None:
        view_layer_of(context).update()  # until then, it cannot be selected
        select_only(context, pair.shown)


class ShowAs(bpy.types.Operator):
    """Show the Gaussians in full or as points"""

    bl_idname = "roigs.show_as"
    bl_label = "Gaussians or Points"

    way: EnumProperty(items=SHOWN_AS, options=FRESH)

    @classmethod
    def description(cls, _: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip."""
        return next(text for name, _, text in SHOWN_AS if name == properties.way)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Switch all Gaussians of the scene."""
        splats.show_as(scene_of(context), self.way)
        redraw()
        return {"FINISHED"}


class ShowInRenders(bpy.types.Operator):
    """Merge the Gaussians into this scene's renders: adds a node to its compositor"""

    bl_idname = "roigs.show_in_renders"
    bl_label = "Show in Renders"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians."""
        return available(cls, "" if lookup.splats(scene_of(context)) else NO_GAUSSIANS)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Add the node."""
        compositor.link(scene_of(context))
        return {"FINISHED"}


class SelectGaussians(bpy.types.Operator):
    """Select these Gaussians, to move or edit them"""

    bl_idname = "roigs.select_gaussians"
    bl_label = "Select Gaussians"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the object", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Select the object, and nothing else."""
        scene = scene_of(context)
        shown = (*lookup.splats(scene), *lookup.of_kind(scene, "SURFACE"))
        item = next((item for item in shown if item.name_full == self.name), None)
        if item is None:
            return failed(self, f"There are no Gaussians '{self.name}'.")
        select_only(context, item)
        return {"FINISHED"}


@persistent
def _follow(*_: object) -> None:
    """A training that was stopped may have moved aside what the scenes show; or a person, all."""
    for scene in bpy.data.scenes:
        splats.follow(scene, run_folders.run_folder(scene))
        carried.bring_back(scene)


_start, _end = following(("load_post", _follow))


_register, _unregister = registration(
    LoadResults, DeleteResult, SetDetail, ShowAs, ShowInRenders, SelectGaussians
)


def register() -> None:
    """Register the operators, and follow trainings."""
    _register()
    _start()
    current.on_end.append(_follow)


def unregister() -> None:
    """Undo `register`."""
    current.on_end.remove(_follow)
    _end()
    _unregister()
