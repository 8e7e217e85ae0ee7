"""File ▸ Import ▸ Gaussians, and drops of files of Gaussians on a 3D view."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import bpy
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..blender import absolute, registration
from ..errors import AddonError
from ..jobs import current, import_gaussians_job
from ..jobs.spec import JobSpec
from . import folders
from .base import BUSY, FRESH, BrowsingOperator, EngineOperator, available

if TYPE_CHECKING:
    from ..blender import OperatorResult

ENDINGS = tuple(e for e in import_gaussians_job.ENDINGS if e.count(".") == 1)
MORE = import_gaussians_job.ONLY_IMPORTED


class ImportGaussians(BrowsingOperator, ImportHelper):  # type: ignore[misc] # the stub's mixin
    """Import a file of Gaussians as an object to move, edit, render and export"""

    bl_idname = "roigs.import_gaussians"
    bl_label = "Import Gaussians"

    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    filter_glob: StringProperty(
        default=";".join(f"*{ending}" for ending in (*ENDINGS, *MORE)), options={"HIDDEN", *FRESH}
    )
    up: EnumProperty(
        name="Up",
        description="Up axis of the file",
        items=[
            (
                "AUTO",
                "Automatic",
                "The file's own; otherwise -Y in PLY, SOG, .splat, Y in SPZ, glTF, OpenUSD",
            ),
            ("-Y", "-Y", "As most trainers of Gaussians write it"),
            ("Y", "Y", "As in glTF and many game engines"),
            ("Z", "Z, as in Blender", "Coordinates are not changed"),
            ("COLMAP", "As This Scene", "It was trained on this scene's photos"),
        ],
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The engine must be idle."""
        return available(cls, BUSY if current.busy() else "")

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Convert the file, then show it."""
        if not self.filepath or self.filepath.endswith(("/", os.sep)):
            raise AddonError("Give a filepath: a file of Gaussians.")
        path = absolute(self.filepath)
        up = "" if self.up == "AUTO" else self.up.lower()
        spec = import_gaussians_job.spec(context, path, up)
        folders.imported_gaussians(path)
        return spec

    def invoke(  # type: ignore[override] # the stub of the mixin returns nothing
        self, context: bpy.types.Context, event: bpy.types.Event
    ) -> OperatorResult:
        """Import a file that was dropped, else ask for one."""
        if self.filepath:
            return EngineOperator.invoke(self, context, event)
        assert context.window_manager is not None
        self.filepath = folders.for_gaussians()
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class GaussiansHandler(bpy.types.FileHandler):
    """Files of Gaussians that are dropped on a 3D view: a menu, where Blender reads them too."""

    bl_idname = "ROIGS_FH_gaussians"
    bl_label = "Gaussians (ROI-GS)"
    bl_import_operator = ImportGaussians.bl_idname
    bl_file_extensions = ";".join((*ENDINGS, *(e for e in MORE if e[0] == ".")))

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """In 3D views."""
        return isinstance(context.space_data, bpy.types.SpaceView3D)


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in File ▸ Import."""
    assert menu.layout is not None
    text = "Gaussians (.ply, .spz, .glb …, ROI-GS)"
    menu.layout.operator(ImportGaussians.bl_idname, text=text)


register, unregister = registration(
    ImportGaussians, GaussiansHandler, menus={"TOPBAR_MT_file_import": menu_entry}
)
