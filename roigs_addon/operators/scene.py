"""Step 1, Scene: import a COLMAP model, refine its cameras, look through its photos."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..blender import registration, scene_of, view_3d_of, view_layer_of
from ..engine.python import FOR_READING
from ..facts import run_facts
from ..jobs import current, import_job, refine_job
from ..jobs.spec import JobSpec
from ..properties import scene_props
from ..scene import cameras, lookup
from ..shared import projects
from . import folders
from .base import BUSY, FRESH, BrowsingOperator, EngineOperator, available, failed, model_problem

if TYPE_CHECKING:
    from ..blender import OperatorResult


class ImportColmap(BrowsingOperator, ImportHelper):  # type: ignore[misc] # the stub's mixin
    """Import cameras, photos and points from the folder of a COLMAP project"""

    bl_idname = "roigs.import_colmap"
    bl_label = "Import Cameras"

    directory: StringProperty(subtype="DIR_PATH", options=FRESH)
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    images: StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        description="Folder of the photos (empty: found automatically)",
        options=FRESH,
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", *FRESH})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One job at a time."""
        return available(cls, BUSY if current.busy() else "")

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Reading a model needs little."""
        return FOR_READING

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Export the model to the cache, then build objects from that."""
        chosen = self.directory or self.filepath
        spec = import_job.spec(scene_of(context), chosen, self.images)
        folders.imported(Path(bpy.path.abspath(chosen)))
        return spec

    def invoke(  # type: ignore[override] # the stub of the mixin returns nothing
        self, context: bpy.types.Context, event: bpy.types.Event
    ) -> OperatorResult:
        """Ask for the folder, unless it was given; the file browser then calls `execute`."""
        if self.directory or self.filepath:
            return EngineOperator.invoke(self, context, event)
        assert context.window_manager is not None
        self.directory = folders.for_import(scene_props(scene_of(context)).colmap)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class RefineCameras(EngineOperator):
    """Improve the cameras with a better lens model, for sharper results"""

    bl_idname = "roigs.refine_cameras"
    bl_label = "Refine Cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a model whose cameras are not refined, and an idle engine."""
        folder = Path(scene_props(scene_of(context)).colmap)
        refined = "The cameras are refined already" if _is_refined(folder) else ""
        return available(cls, model_problem(context) or refined)

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Refining needs more than reading."""
        return refine_job.packages(scene_of(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Write the refined model, then import it."""
        return refine_job.spec(scene_of(context))


def _is_refined(folder: Path) -> bool:
    """Whether it is the folder of a refined model."""
    named = projects.is_refined_name(folder)
    return named and run_facts.is_file(folder / projects.CAMERAS_FILE)


class LookThrough(bpy.types.Operator):
    """Look through this photo's camera, at its resolution, with the photo beside the Gaussians"""

    bl_idname = "roigs.look_through"
    bl_label = "Look Through"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(
        description="Name of the photo; empty: the active object's, else the active camera's,"
        " else the first one",
        options=FRESH,
    )
    step: IntProperty(description="Number of photos to move", default=0, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Make the camera active and look through it."""
        item = self._camera(context)
        if item is None:
            return failed(self, self._missing(context))
        cameras.activate(scene_of(context), item)
        if lookup.camera_at_hand(context) != item:  # another photo's camera is the active object
            with suppress(RuntimeError):  # not an object of this view layer
                view_layer_of(context).objects.active = item
        view = view_3d_of(context)
        if view is not None and view.region_3d is not None:
            view.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}

    def _missing(self, context: bpy.types.Context) -> str:
        if self.photo and lookup.cameras(scene_of(context)):
            return "There is no such photo. Use its name in the COLMAP model."
        return "There are no photos. Reconstruct photos or import cameras first."

    def _camera(self, context: bpy.types.Context) -> bpy.types.Object | None:
        found = lookup.cameras(scene_of(context))
        if self.photo:
            return found.get(self.photo)
        if self.step and found:
            names = sorted(found)
            active = lookup.camera_at_hand(context)
            photo = lookup.photo_record(active) if active else None
            at = names.index(photo.name) + self.step if photo and photo.name in names else 0
            return found[names[at % len(names)]]
        at_hand = lookup.camera_at_hand(context)
        return at_hand or next((found[name] for name in sorted(found)), None)


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in File ▸ Import."""
    layout = menu.layout
    assert layout is not None
    layout.operator(ImportColmap.bl_idname, text="Cameras (COLMAP, ROI-GS)")


register, unregister = registration(
    ImportColmap, RefineCameras, LookThrough, menus={"TOPBAR_MT_file_import": menu_entry}
)
