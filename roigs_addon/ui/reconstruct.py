"""Before step 1: make a scene from photos."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..engine.reconstruction import ReconstructionStatus
from ..facts import reconstructions, weak_photos
from ..jobs import current
from ..jobs.spec import RECONSTRUCTING
from ..operators.reconstruct import ChoosePhotos, Reconstruct, ShowReport
from ..operators.train import ShowLog
from ..properties import scene_props
from . import layout as show
from .layout import SidebarPanel

MOST_REMARKS = 4
"""Most remarks shown; the report has all."""


class PhotosPanel(SidebarPanel):
    """The folder of the photos, the button, and how far the reconstruction is."""

    bl_idname = "ROIGS_PT_photos"
    bl_label = "Photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The scene must not have a COLMAP model from elsewhere."""
        props = scene_props(scene_of(context))
        return bool(props.photos) or not props.colmap

    def draw(self, context: bpy.types.Context) -> None:
        """Show the folders, the buttons, and the state of the reconstruction."""
        layout, scene = layout_of(self), scene_of(context)
        props = scene_props(scene)
        layout.operator(ChoosePhotos.bl_idname, icon="FILE_FOLDER")
        if not props.photos:
            show.todo(layout, "Choose a folder of photos, or import a COLMAP project below")
            return
        column = show.setting_column(layout)
        column.enabled = not current.busy()
        column.prop(props, "photos")
        column.prop(props, "project")
        folder, status, masks = reconstructions.of(scene)
        if not props.project:
            show.say(column, str(folder), "BLANK1")
        column.prop(props, "masks")
        if masks and not props.masks:
            show.say(column, str(masks), "BLANK1")
        row = layout.row(align=True)
        text = "Continue" if status.unfinished and not current.busy() else Reconstruct.bl_label
        row.operator(Reconstruct.bl_idname, text=text, icon="PLAY")
        row.operator(ShowLog.bl_idname, text="", icon="TEXT")
        state = current.state()
        if state.title == RECONSTRUCTING and (current.busy() or state.error):
            show.job(layout, RECONSTRUCTING)
        else:
            _draw_status(layout, status, weak=bool(weak_photos.used(scene)))
        if status.summary and not current.busy():
            layout.operator(ShowReport.bl_idname, icon="TEXT")


def _draw_status(layout: bpy.types.UILayout, status: ReconstructionStatus, *, weak: bool) -> None:
    """Show the state. With weak photos, which step 1 lists, it is not shown as a success."""
    if status.holder:
        text = f"Another Blender or terminal is at work here (process {status.holder})"
        show.paused(layout, text)
    elif status.unfinished and status.summary and not status.done:
        show.wrong(layout, status.summary)  # no photo could be placed
    elif status.unfinished:
        show.paused(layout, "Stopped before the end; Continue resumes")
    elif not status.done:
        show.todo(layout, "Not reconstructed yet: click Reconstruct")
    else:
        show.say(layout, status.summary, "INFO" if weak or status.remarks else "CHECKMARK")
        for text in status.remarks[:MOST_REMARKS]:
            show.wrong(layout, text)
        if len(status.remarks) > MOST_REMARKS:
            show.say(layout, f"{len(status.remarks) - MOST_REMARKS} more in the report", "BLANK1")


class PhotosOptionsPanel(SidebarPanel):
    """Rarely changed settings."""

    bl_idname = "ROIGS_PT_photos_options"
    bl_parent_id = PhotosPanel.bl_idname
    bl_label = "Options"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Show size of the photos, pairs and cameras."""
        column = show.setting_column(layout_of(self))
        column.enabled = not current.busy()
        for name in ("feature_side", "pairs", "shared_cameras"):
            column.prop(scene_props(scene_of(context)), name)


register, unregister = registration(PhotosPanel, PhotosOptionsPanel)
