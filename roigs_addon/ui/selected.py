"""Step 3, Cameras: the selected photos of the active box."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..blender import layout_of, registration, scene_of
from ..facts import photo_names, photo_pictures
from ..jobs.spec import SELECTING
from ..operators.photos import EditSelection, SelectCameras
from ..operators.scene import LookThrough
from ..properties import RoigsPhotoItem, object_props, scene_props
from ..scene import exclusions as used
from ..scene import lookup, selections
from ..shared import text
from . import exclusions
from . import layout as show
from .cameras import CamerasPanel
from .layout import SidebarPanel

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

EDIT_ICONS: dict[str, IconItems] = {
    "ADD": "ADD",
    "REMOVE": "REMOVE",
    "UP": "TRIA_UP",
    "DOWN": "TRIA_DOWN",
}
PICTURE_SCALE = 6.0
"""Size of the active photo's thumbnail, in heights of a button."""
EFFECTS = {
    "joint": "Optional: it hardly changes the result",
    "independent": "Each box trains on its selected photos alone",
}
"""Strategy -> effect of the selection."""


class PhotoList(bpy.types.UIList):
    """The photos of a box, best first."""

    bl_idname = "ROIGS_UL_photos"

    def draw_item(  # type: ignore[override] # Blender passes as much as the function takes
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: object,
        item: RoigsPhotoItem,
        _icon: int,
        _active_data: object,
        _active_property: str,
    ) -> None:
        """Show the name, the score as a bar, and a button that looks through the camera."""
        excluded = used.is_excluded(scene_of(context), item.name)
        split = layout.split(factor=0.36, align=True)
        split.active = not excluded
        split.label(text=photo_names.short_name(scene_of(context), item.name))
        row = split.row(align=True)
        if excluded:
            row.label(text="excluded")
        elif item.score:
            row.progress(factor=min(max(item.score, 0.0), 1.0), text=f"{item.score:.0%} covered")
        else:
            row.label(text="by hand")
        row.operator(LookThrough.bl_idname, text="", icon="HIDE_OFF").photo = item.name


class SelectedPanel(SidebarPanel):
    """Selection of photos, and the selected ones."""

    bl_idname = "ROIGS_PT_selected"
    bl_parent_id = CamerasPanel.bl_idname
    bl_label = "Selected Photos"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Show the purpose, the method, the button, and the photos of the active box."""
        layout, scene, roi = layout_of(self), scene_of(context), lookup.active_roi(context)
        props = scene_props(scene)
        show.say(layout, EFFECTS.get(props.strategy, EFFECTS["joint"]), "INFO")
        column = show.setting_column(layout)
        column.prop(props, "method")
        show.or_number(column, props, "Photos", "all_useful", "count")
        layout.operator(SelectCameras.bl_idname, icon="CAMERA_DATA")
        if show.job(layout, SELECTING) or roi is None:
            return
        photos = object_props(roi).selection
        if not photos:
            show.done(layout, f"{roi.name}: training selects its photos")
            label = "Add Selected Cameras"
            layout.operator(EditSelection.bl_idname, text=label, icon="ADD").action = "ADD"
            return
        if not selections.is_stale(roi, scene):  # else step 3 says so above
            order = "best first" if object_props(roi).selected_box else "chosen by hand"
            show.done(layout, f"{roi.name}: {text.counted(len(photos), 'photo')}, {order}")
        _draw_list(layout, roi, scene)


def _draw_list(layout: bpy.types.UILayout, roi: bpy.types.Object, scene: bpy.types.Scene) -> None:
    row, props = layout.row(), object_props(roi)
    row.template_list(PhotoList.bl_idname, "", props, "selection", props, "selection_index", rows=5)
    column = row.column(align=True)
    for action, icon in EDIT_ICONS.items():
        column.operator(EditSelection.bl_idname, text="", icon=icon).action = action
    layout.operator(EditSelection.bl_idname, text="Clear List", icon="X").action = "CLEAR"
    if 0 <= props.selection_index < len(props.selection):
        photo = props.selection[props.selection_index].name
        layout.separator()
        if picture := photo_pictures.icon(scene, photo):
            layout.template_icon(icon_value=picture, scale=PICTURE_SCALE)
        exclusions.toggle(layout, scene, photo)


register, unregister = registration(PhotoList, SelectedPanel)
