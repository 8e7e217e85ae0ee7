"""Step 5, Result: the surfaces of boxes as meshes."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..blender import layout_of, mesh_of, registration, scene_of, view_3d_of
from ..facts import run_facts
from ..jobs import current, surface_job
from ..jobs.spec import SURFACES
from ..operators.results import SelectGaussians
from ..operators.surface import ExportSurface, MakeSurface, ShowAlone, ShowSurface
from ..properties import object_props, scene_props
from ..scene import box_surfaces, lookup
from . import layout as show
from .layout import SidebarPanel
from .result import ResultPanel

PRECISION = 3


class SurfacePanel(SidebarPanel):
    """The meshes, what is shown of each box, and the buttons that make them."""

    bl_idname = "ROIGS_PT_surface"
    bl_parent_id = ResultPanel.bl_idname
    bl_label = "Surface"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a result, or a mesh of one."""
        scene = scene_of(context)
        return bool(run_facts.run(scene).result or box_surfaces.surfaces(scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Show each mesh's buttons and facts, the settings, and the buttons that make meshes."""
        layout, scene = layout_of(self), scene_of(context)
        items = box_surfaces.surfaces(scene)
        for item in items:
            column = layout.column(align=True)
            button = column.operator(
                SelectGaussians.bl_idname, text=item.name, depress=item.select_get()
            )
            button.name = item.name_full
            row, now = column.row(align=True), box_surfaces.way_of(scene, item)
            for way, label, _ in box_surfaces.WAYS:
                button = row.operator(ShowSurface.bl_idname, text=label, depress=now == way)
                button.name, button.way = item.name_full, way
            row = column.row(align=True)
            alone = box_surfaces.alone(scene) and not object_props(item).beside
            row.operator(ShowAlone.bl_idname, depress=alone).name = item.name_full
            row.operator(ExportSurface.bl_idname).name = item.name_full
            show.say(layout, facts(scene, item), "INFO")
            if not current.busy() and box_surfaces.is_of_other_result(scene, item):
                show.wrong(layout, f"'{item.name}' belongs to another result: make it again")
        if not items:
            show.todo(layout, "Make a mesh to light, print or measure an object")
        elif _is_grey(context, items):
            show.todo(layout, "To see the texture, choose Material Preview in the view's header")
        _draw_making(layout, context)
        show.job(layout, SURFACES)


def _draw_making(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Show settings and buttons; name edited meshes before they are replaced."""
    scene, (name, _) = scene_of(context), surface_job.box_at_hand(context)
    column = show.setting_column(layout)
    column.prop(scene_props(scene), "faces")
    column.prop(scene_props(scene), "watertight")
    show.or_number(column, scene_props(scene), "Texture", "fine_texture", "texture_size", "Side")
    edited = box_surfaces.edited(scene)
    for mesh in edited:
        show.wrong(layout, f"'{mesh}' was edited: making it again replaces it. Undo restores it")
    column = layout.column(align=True)  # side by side, names would be cut
    label = f"Make Surface: {name}" if name else MakeSurface.bl_label
    button = column.operator(MakeSurface.bl_idname, text=label, icon="MESH_MONKEY")
    button.replace_edits = bool(edited)
    if len(lookup.rois(scene)) > 1:
        button = column.operator(MakeSurface.bl_idname, text="Make All Surfaces")
        button.every, button.replace_edits = True, bool(edited)


def _is_grey(context: bpy.types.Context, items: list[bpy.types.Object]) -> bool:
    """Whether the view shows a mesh without its texture."""
    space = view_3d_of(context)
    if space is None or all(item.hide_viewport for item in items):
        return False
    return space.shading.type == "SOLID" and space.shading.color_type != "TEXTURE"


def facts(scene: bpy.types.Scene, item: bpy.types.Object) -> str:
    """Describe faces, size in the scene's units, volume if closed, and the share of filled holes.

    An edited mesh has only its faces and the size along its own axes.
    """
    said = [f"{len(mesh_of(item).polygons):,} faces"]
    if box_surfaces.is_edited(item):
        return ", ".join((*said, _large(scene, lookup.sides(item)), "edited"))
    record = box_surfaces.record(item)
    scale = float(np.cbrt(abs(np.linalg.det(lookup.matrix_world(item)))))
    said.append(_large(scene, [side * scale for side in record.get("size", ())]))
    if volume := record.get("volume"):
        said.append(f"closed, {_in_units(scene, 'VOLUME', volume * scale**3)}")
    else:
        said.append("with holes")
    if filled := record.get("filled"):
        said.append(f"{filled:.1%} filled")
    return ", ".join(filter(None, said))


def _large(scene: bpy.types.Scene, sides: Any) -> str:
    return " × ".join(_in_units(scene, "LENGTH", side) for side in sides)


def _in_units(scene: bpy.types.Scene, kind: Any, value: float) -> str:
    """Format a length or a volume in the scene's units."""
    settings = scene.unit_settings
    power = {"LENGTH": 1, "VOLUME": 3}[kind]
    value *= settings.scale_length**power if settings.system != "NONE" else 1
    return bpy.utils.units.to_string(settings.system, kind, value, precision=PRECISION).strip()


register, unregister = registration(SurfacePanel)
