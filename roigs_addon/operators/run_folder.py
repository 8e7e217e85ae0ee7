"""Step 5, Result: compare the results of a run folder, and clean it up."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, StringProperty

from ..blender import registration, scene_of
from ..errors import AddonError
from ..facts import caches, run_facts
from ..jobs import current, run_folders
from ..properties import scene_props
from ..scene import carried, compared, splats
from ..shared import EngineError, clean_up, files, lock, text
from .base import BUSY, FRESH, available, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult


class CompareResults(bpy.types.Operator):
    """Switch between the last result and an earlier one; the view and the objects do not change"""

    bl_idname = "roigs.compare_results"
    bl_label = "Compare A/B"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One result must be shown, and another one must be there."""
        scene, reason = scene_of(context), ""
        if current.busy():
            reason = BUSY
        elif compared.shown_result(scene) is None:
            reason = "Load a result first"
        elif _other(scene) is None:
            reason = "There is no other result to compare with"
        return available(cls, reason)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Show the other one; remember an earlier one, to come back to it."""
        scene = scene_of(context)
        shown, other = compared.shown_result(scene), _other(scene)
        if other is None:
            return failed(self, "There is no other result.")
        try:
            compared.switch(scene, other)
        except AddonError as error:
            return failed(self, error)
        if shown is not None and shown != run_folders.run_folder(scene):
            scene_props(scene).compared = shown.name
        caches.forget()
        return {"FINISHED"}


def _other(scene: bpy.types.Scene) -> Path | None:
    """The result to switch to: the last one; from there, the earlier one that was shown last."""
    shown, last = compared.shown_result(scene), run_folders.run_folder(scene)
    earlier = [result.folder for result in run_facts.earlier(scene)]
    found = [last] if run_facts.run(scene).result else []
    found += sorted(earlier, key=lambda folder: folder.name != scene_props(scene).compared)
    return next((folder for folder in found if folder != shown), None)


class FindFolder(bpy.types.Operator):
    """Choose the new place of the run folder. Without it, the models are drawn from the .blend, \
but training and levels of detail start again"""

    bl_idname = "roigs.find_folder"
    bl_label = "Find Folder"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options=FRESH)
    filter_folder: BoolProperty(default=True, options={"HIDDEN", *FRESH})

    @classmethod
    def description(
        cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties
    ) -> str:
        """With the folder where it was."""
        return f"{cls.__doc__}. It was {run_folders.run_folder(scene_of(context))}"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the folder; the file browser then calls `execute`."""
        assert context.window_manager is not None
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Look in the folder, then in those that are directly in it."""
        scene, chosen = scene_of(context), Path(bpy.path.abspath(self.directory))
        within = [Path(path) for path in files.matching(chosen, "*") if os.path.isdir(path)]
        folder = next((f for f in (chosen, *within) if splats.follow(scene, f)), None)
        if folder is None:
            return failed(self, f"{chosen} has none of the models in this scene.")
        carried.bring_back(scene)
        if not run_folders.run_folder(scene).is_dir():
            scene_props(scene).run_dir = str(folder)
        caches.forget()
        return {"FINISHED"}


class CleanUp(bpy.types.Operator):
    """Remove files that training can recreate: undistorted photos, stages of earlier settings, \
an old preview. Results stay"""

    bl_idname = "roigs.clean_up"
    bl_label = "Clean Up"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be something to remove, and no engine at work."""
        reason, scene = "", scene_of(context)
        if current.busy() or run_facts.run(scene).holder:
            reason = BUSY
        elif not run_facts.disk(scene).removable:
            reason = "The run folder has nothing to remove"
        return available(cls, reason)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask first, with the size."""
        assert context.window_manager is not None
        size = text.in_gb(run_facts.disk(scene_of(context)).removable)
        return context.window_manager.invoke_confirm(
            self,
            event,
            title=f"Remove {size} from the run folder?",
            message="Results stay. Earlier settings then need a new training.",
            confirm_text=self.bl_label,
        )

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove the files."""
        folder = run_folders.run_folder(scene_of(context))
        try:
            with lock.locked(folder):
                freed = clean_up.remove(folder)
        except EngineError as error:
            return failed(self, str(error))
        caches.forget()
        self.report({"INFO"}, f"Removed {text.in_gb(freed)}")
        return {"FINISHED"}


register, unregister = registration(CompareResults, FindFolder, CleanUp)
