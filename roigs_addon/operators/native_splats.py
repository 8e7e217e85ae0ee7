"""Step 5, Result: convert Gaussians to Blender's own splats (5.3 and later), and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from mathutils import Matrix

from ..blender import leave_edit_mode, registration, scene_of, select_only
from ..engine.own_files import IMPORTED, OWN
from ..engine.writing import made_folder, writing
from ..errors import AddonError
from ..geometry.splat_cloud import write_splats
from ..jobs import run_folders
from ..jobs.import_gaussians_job import free_file
from ..scene import lookup, native_splats, point_edits, splats
from ..shared import names
from .base import available, failed

if TYPE_CHECKING:
    from ..blender import OperatorResult

TOO_OLD = "Blender has its own splats from version 5.3 on"
NONE_NATIVE = "Select an object of Blender's own splats"


class ToNative(bpy.types.Operator):
    """Convert the selected Gaussians, or all visible ones, to Blender's own splats with their \
current look; the Gaussians are hidden"""

    bl_idname = "roigs.to_native_splats"
    bl_label = "To Blender's Splats"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """This Blender must have them, and there must be Gaussians."""
        if not native_splats.exist():
            return available(cls, TOO_OLD)
        return available(cls, "" if point_edits.targets(context) else point_edits.NONE)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """One object for each; none if one fails."""
        leave_edit_mode(lookup.splats(scene_of(context)))
        made: dict[bpy.types.Object, bpy.types.Object] = {}
        try:
            for item in point_edits.chosen_or_visible(context):
                made[item] = native_splats.of(item)
        except AddonError as error:
            for other in made.values():
                bpy.data.objects.remove(other)
            return failed(self, error)
        chosen = [other for item, other in made.items() if item == context.active_object]
        select_only(context, (chosen or [*made.values()])[0])
        for item, other in made.items():
            other.select_set(True)
            item.hide_viewport = item.hide_render = True
        return {"FINISHED"}


class FromNative(bpy.types.Operator):
    """Convert the selected object of Blender's own splats to Gaussians, to clean up, recolour and \
export them; the splats are hidden"""

    bl_idname = "roigs.from_native_splats"
    bl_label = "From Blender's Splats"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must be one."""
        item = context.active_object
        return available(cls, "" if item and native_splats.are_in(item) else NONE_NATIVE)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Write them into the run folder, as imported ones are, and show the file."""
        scene, item = scene_of(context), context.active_object
        assert item is not None
        try:
            cloud = native_splats.cloud_in(item)
            folder = made_folder(run_folders.settle(scene), OWN, IMPORTED)
            path = free_file(folder, names.safe_name(item.name))
            with writing(path.parent, "Run Folder"):
                write_splats(path, cloud)
            made = splats.show_imported(scene, path, item.name, in_model=False)
        except AddonError as error:
            return failed(self, error)
        made.matrix_world = Matrix(lookup.matrix_world(item).tolist())
        item.hide_viewport = item.hide_render = True
        select_only(context, made)
        return {"FINISHED"}


register, unregister = registration(ToNative, FromNative)
