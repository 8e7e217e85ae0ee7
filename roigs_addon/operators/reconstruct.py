"""Photos: choose their folder, reconstruct them, read the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, StringProperty

from ..blender import absolute, registration, scene_of
from ..engine.python import FOR_RECONSTRUCTING
from ..errors import AddonError
from ..facts import reconstructions
from ..jobs import current, reconstruct_job
from ..jobs.spec import JobSpec
from ..properties import scene_props
from . import folders, texts
from .base import BUSY, FRESH, EngineOperator, available, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult

REPORT = "ROI-GS reconstruction"
NO_REPORT = "There is no report yet"


class ChoosePhotos(bpy.types.Operator):
    """Choose a folder of photos, or a video, to make a scene; COLMAP is not needed. Reads JPEG, \
PNG, TIFF, BMP, WebP, JPEG 2000, PPM and HEIC; export RAW files as JPEG first"""

    bl_idname = "roigs.choose_photos"
    bl_label = "Choose Photos"
    bl_options = {"UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options=FRESH)
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    filter_folder: BoolProperty(default=True, options={"HIDDEN", *FRESH})
    filter_image: BoolProperty(default=True, options={"HIDDEN", *FRESH})
    filter_movie: BoolProperty(default=True, options={"HIDDEN", *FRESH})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while the engine works on others."""
        return available(cls, BUSY if current.busy() else "")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the folder."""
        assert context.window_manager is not None
        self.directory = folders.for_photos(scene_props(scene_of(context)).photos)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Put it into the scene's settings."""
        try:
            video = reconstruct_job.is_video(Path(self.filepath))
            chosen = self.filepath if video else self.directory or self.filepath
            take_photos(scene_of(context), chosen)
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


def take_photos(scene: bpy.types.Scene, chosen: str) -> None:
    """Make a folder or a video the scene's photos; of a photo, its folder.

    Raises:
        AddonError: there is no such folder.
    """
    folder = reconstruct_job.photos_folder(chosen)
    if scene_props(scene).photos != str(folder):
        scene_props(scene).photos = str(folder)
    folders.chosen_photos(folder)


class Reconstruct(EngineOperator):
    """Find the cameras of the photos and points of the scene, and import them. A stopped \
reconstruction resumes"""

    bl_idname = "roigs.reconstruct"
    bl_label = "Reconstruct"

    photos: StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        description="Folder of the photos, or a video (empty: the scene's)",
        options=FRESH,
    )
    project: StringProperty(
        name="Project Folder",
        subtype="DIR_PATH",
        description="Where the COLMAP project goes (empty: beside the photos)",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One job at a time."""
        return available(cls, BUSY if current.busy() else "")

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Reconstructing needs no torch."""
        return FOR_RECONSTRUCTING

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make the project, then import it."""
        scene = scene_of(context)
        project = str(absolute(self.project)) if self.project else ""
        if self.photos:
            take_photos(scene, self.photos)
        if project:
            scene_props(scene).project = project
        return reconstruct_job.spec(scene)


class ShowReport(bpy.types.Operator):
    """Open the report in the text editor: registered photos, and the reasons for unregistered \
ones"""

    bl_idname = "roigs.show_reconstruction"
    bl_label = "Show Report"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a report."""
        return available(cls, "" if reconstructions.report(scene_of(context)) else NO_REPORT)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Load it as a text, and show that."""
        path = reconstructions.report(scene_of(context))
        if path is None:
            return failed(self, f"{NO_REPORT}.")
        texts.show(REPORT, path)
        return {"FINISHED"}


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in File ▸ Import."""
    layout = menu.layout
    assert layout is not None
    layout.operator(ChoosePhotos.bl_idname, text="Photos (ROI-GS)")


register, unregister = registration(
    ChoosePhotos, Reconstruct, ShowReport, menus={"TOPBAR_MT_file_import": menu_entry}
)
