"""Drop of photos or a video on a 3D view: sets the scene's photos.

Blender passes on only files with known suffixes, so a folder cannot be dropped. It has its own
handler for pictures in a 3D view, and shows a menu of both.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import CollectionProperty, StringProperty

from ..blender import registration, scene_of
from ..errors import AddonError
from ..jobs import current, reconstruct_job
from ..shared import projects
from .base import BUSY, FRESH, available, failed
from .reconstruct import take_photos

if TYPE_CHECKING:
    from ..blender import OperatorResult

TAB = "ROI-GS"


class DropPhotos(bpy.types.Operator):
    """Use the folder of the dropped photos, or the video, for a reconstruction; nothing starts \
yet"""

    bl_idname = "roigs.drop_photos"
    bl_label = "Photos for ROI-GS"
    bl_options = {"UNDO", "INTERNAL"}

    directory: StringProperty(subtype="DIR_PATH", options=FRESH)
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while the engine works on others."""
        return available(cls, BUSY if current.busy() else "")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Put the folder into the scene's settings, and show the panel."""
        try:
            first = Path(self.directory, self.files[0].name) if self.files else None
            video = first is not None and reconstruct_job.is_video(first)
            take_photos(scene_of(context), str(first) if video else self.directory)
        except AddonError as error:
            return failed(self, error)
        _show_tab(context.area)
        return {"FINISHED"}


def _show_tab(area: bpy.types.Area | None) -> None:
    """Show the add-on's tab in the sidebar of a 3D view."""
    space = area.spaces.active if area else None
    if area is None or not isinstance(space, bpy.types.SpaceView3D):
        return
    space.show_region_ui = True
    for region in area.regions:
        if region.type == "UI":
            with suppress(AttributeError, TypeError):  # read-only, or not drawn yet
                setattr(region, "active_panel_category", TAB)  # noqa: B010 - unknown to the stubs


class PhotosHandler(bpy.types.FileHandler):
    """Photos that are dropped on a 3D view."""

    bl_idname = "ROIGS_FH_photos"
    bl_label = "Photos for ROI-GS"
    bl_import_operator = DropPhotos.bl_idname
    bl_file_extensions = ";".join(
        (*(".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".heic"), *sorted(projects.VIDEOS))
    )

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """In 3D views, where Blender's own handler takes pictures, too."""
        return isinstance(context.space_data, bpy.types.SpaceView3D)


register, unregister = registration(DropPhotos, PhotosHandler)
