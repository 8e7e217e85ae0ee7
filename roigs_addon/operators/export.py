"""Step 5, Result: export the Gaussians."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..blender import absolute, registration, scene_of, view_layer_of
from ..errors import AddonError
from ..jobs import current, export_job, import_gaussians_job, import_job
from ..jobs.spec import JobSpec
from ..properties import scene_props
from ..scene import instances
from ..scene.frame_request import shown
from . import folders
from .base import BUSY, FRESH, BrowsingOperator, available

if TYPE_CHECKING:
    from ..blender import OperatorResult


ENDINGS = (*import_gaussians_job.ENDINGS, ".html")
"""Of names that say the format, whatever is chosen; `.compressed.ply` before `.ply`."""
UNNAMED = "Gaussians"
"""Of a file, if neither a project nor a .blend gives a name."""
NOTHING = "Renders show no Gaussians. Load results or import some first"
GLOB = ";".join(f"*{ending}" for ending in ENDINGS if ending.count(".") == 1)


class ExportGaussians(BrowsingOperator, ExportHelper):
    """Write the Gaussians of a render to one file for other programs, with all edits and \
transforms"""

    bl_idname = "roigs.export_gaussians"
    bl_label = "Export Gaussians"

    file_format: EnumProperty(
        name="Format",
        items=[
            (".ply", "PLY", "Exact; every program with Gaussians reads it"),
            (".spz", "SPZ", "A tenth of the size"),
            (".html", "Web Page", "One file to share: a page with a viewer"),
            (".compressed.ply", "Compressed PLY", "A quarter of the size"),
            (".sog", "SOG", "The smallest, for the web; less exact colours"),
            (".glb", "glTF", "With KHR_gaussian_splatting"),
            (".usdc", "OpenUSD", "As ParticleField3DGaussianSplat"),
            (".splat", ".splat", "For old viewers; colours are the same from all sides"),
        ],
        options=FRESH,
    )
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    filter_glob: StringProperty(default=GLOB, options={"HIDDEN", *FRESH})
    check_existing: BoolProperty(default=True, options={"HIDDEN", *FRESH})
    selected: BoolProperty(
        name="Selected Only",
        description="Leave out unselected objects",
        options=FRESH,
    )
    visible: BoolProperty(
        name="Visible Only",
        description="Leave out objects hidden in the viewport, for example with H",
        default=True,
        options=FRESH,
    )
    up: EnumProperty(
        name="Up",
        description="Up axis of the file",
        items=[
            ("AUTO", "Automatic", "-Y in PLY and SOG, Y in SPZ, glTF and OpenUSD"),
            ("-Y", "-Y", "Upright in SuperSplat and most PLY viewers"),
            ("Y", "Y", "As in glTF and many game engines"),
            ("Z", "Z, as in Blender", "Imports into Blender in the same place"),
        ],
        options=FRESH,
    )
    view_colour: EnumProperty(
        name="View-dependent Colour",
        description="Keep or drop the change of colours with the view direction",
        items=[
            ("FULL", "Full", "As trained: reflections move with the view"),
            ("NONE", "None (¼ of the Size)", "The same colours from all sides: a smaller file"),
        ],
        options=FRESH,
    )

    @property
    def filename_ext(self) -> str:
        """The suffix that the file browser adds."""
        return str(self.file_format)

    def check(  # type: ignore[override] # the stub of the mixin returns nothing
        self, context: bpy.types.Context
    ) -> bool:
        """Give the name the chosen format's ending instead of another's; whether it changed.

        Blender's own check would leave the first half of `.compressed.ply`.
        """
        before = self.filepath
        if os.path.basename(before):
            known = next((each for each in ENDINGS if before.lower().endswith(each)), "")
            self.filepath = f"{before[: len(before) - len(known)]}{self.filename_ext}"
        changed: bool = self.filepath != before
        return changed

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians, and an idle engine."""
        if current.busy():
            return available(cls, BUSY)
        found = shown(scene_of(context)) or instances.in_view(view_layer_of(context))
        return available(cls, "" if found else NOTHING)

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Write what is shown."""
        if not self.filepath:
            raise AddonError("Give a filepath.")
        chosen = absolute(self.filepath)
        if not chosen.name.strip() or self.filepath.endswith(("/", os.sep)):
            raise AddonError(f"{self.filepath} is a folder. Give the name of a file.")
        known = chosen.name.lower().endswith(ENDINGS)
        path = chosen if known else Path(f"{chosen}{self.file_format}")
        up = "" if self.up == "AUTO" else self.up.lower()
        spec = export_job.spec(
            context,
            path,
            up=up,
            sh_degree=3 if self.view_colour == "FULL" else 0,
            selected=self.selected,
            visible=self.visible,
        )
        folders.exported(path)
        return spec

    def invoke(  # type: ignore[override] # the stub of the mixin returns nothing
        self, context: bpy.types.Context, event: bpy.types.Event
    ) -> OperatorResult:
        """Ask for the file; the file browser then calls `execute`."""
        assert context.window_manager is not None
        if not self.filepath:
            colmap = scene_props(scene_of(context)).colmap
            project = import_job.project_name(Path(colmap)) if colmap else ""
            name = project or Path(bpy.data.filepath).stem or UNNAMED
            self.filepath = f"{folders.for_export(colmap)}{name}{self.filename_ext}"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in File ▸ Export."""
    layout = menu.layout
    assert layout is not None
    layout.operator(ExportGaussians.bl_idname, text="Gaussians (.ply, .spz, .glb …, ROI-GS)")


register, unregister = registration(ExportGaussians, menus={"TOPBAR_MT_file_export": menu_entry})
