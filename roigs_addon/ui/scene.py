"""Step 1, Scene."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..blender import layout_of, mesh_of, registration, scene_of
from ..facts import photo_names
from ..geometry.photo import Photo
from ..jobs import current
from ..jobs.import_job import project_name
from ..jobs.spec import IMPORTING, REFINING
from ..operators.scene import ImportColmap, LookThrough, RefineCameras
from ..properties import scene_props
from ..scene import lookup
from ..shared import text
from . import exclusions
from . import layout as show
from .layout import SidebarPanel


class ScenePanel(SidebarPanel):
    """The model and its photos."""

    bl_idname = "ROIGS_PT_scene"
    bl_label = "1. Scene"

    def draw(self, context: bpy.types.Context) -> None:
        """Show import, refinement, the imported model, and the photo to look through."""
        layout, scene = layout_of(self), scene_of(context)
        props = scene_props(scene)
        layout.operator(ImportColmap.bl_idname, text="Import Cameras (COLMAP)", icon="IMPORT")
        layout.operator(RefineCameras.bl_idname, icon="CON_CAMERASOLVER")
        if show.job(layout, IMPORTING) or show.job(layout, REFINING):
            return
        if not props.colmap:
            show.todo(layout, "Reconstruct photos above, or import the folder of a COLMAP project")
            return
        cloud = lookup.points(scene)
        points = len(mesh_of(cloud).vertices) if cloud else 0
        project = project_name(Path(props.colmap))
        photos = text.counted(photo_names.count(scene), "photo")
        show.done(layout, f"{project}: {photos}, {text.counted(points, 'point')}")
        if cloud is not None:
            row = layout.row()
            row.label(text="Sparse points", icon="OUTLINER_OB_POINTCLOUD")
            row.prop(cloud, "hide_viewport", text="", emboss=False)
        exclusions.counted(layout, scene)
        exclusions.weak(layout, scene)
        if props.skipped and not _skipping_is_said():
            show.wrong(layout, props.skipped)
        row = layout.row(align=True)
        name, photo = photo_at_hand(context), _photo(context)
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_LEFT").step = -1
        row.operator(LookThrough.bl_idname, text=name, icon="CAMERA_DATA").step = 0
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_RIGHT").step = 1
        if photo and lookup.splats(scene):
            row = layout.row(align=True)
            row.prop(props, "compare_photo")
            part = row.row(align=True)
            part.active = props.compare_photo
            part.prop(props, "wipe", slider=True)
        if photo:
            exclusions.toggle(layout, scene, photo.name)
        exclusions.selected(layout, context)


def photo_at_hand(context: bpy.types.Context) -> str:
    """Return the text of the button between the arrows: the photo that it looks through."""
    photo = _photo(context)
    return photo_names.short_name(scene_of(context), photo.name) if photo else "Look Through"


def _skipping_is_said() -> bool:
    """Whether the warnings of the import, which are above, name the skipped photos."""
    state = current.state()
    return state.title == IMPORTING and any(w.startswith("Skipped") for w in state.warnings)


def _photo(context: bpy.types.Context) -> Photo | None:
    item = lookup.camera_at_hand(context)
    return lookup.photo_record(item) if item else None


register, unregister = registration(ScenePanel)
