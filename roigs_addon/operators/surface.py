"""Step 5, Result: the content of a box as a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..blender import registration, scene_of, select_only, view_3d_of, view_layer_of
from ..engine.python import FOR_SURFACES
from ..errors import AddonError
from ..jobs import surface_job
from ..jobs.spec import JobSpec
from ..properties import object_props
from ..scene import box_surfaces, splats
from ..windows import redraw
from .base import FRESH, NO_BOX, EngineOperator, available, failed, result_problem

if TYPE_CHECKING:
    from ..blender import OperatorResult

NO_MESH = "There is no mesh '{}'."
STL = ".stl"
MILLIMETRES = 1000.0
"""In a metre: what reads STL takes its numbers for millimetres."""


class MakeSurface(EngineOperator):
    """Make a mesh of the object in the active box, with texture from the photos. It replaces the \
Gaussians in the view, and an earlier mesh"""

    bl_idname = "roigs.make_surface"
    bl_label = "Make Surface"

    every: BoolProperty(name="All Boxes", description="Of all boxes of the result", options=FRESH)
    replace_edits: BoolProperty(
        name="Replace Edits", description="Also replace edited meshes", options=FRESH
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        none = "" if surface_job.box_at_hand(context)[0] else NO_BOX
        return available(cls, result_problem(context) or none)

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that make meshes."""
        return FOR_SURFACES

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make it in the scene's run folder."""
        scene = scene_of(context)
        name, trained = surface_job.box_at_hand(context)
        if not name:
            raise AddonError(f"{NO_BOX}.")
        if not trained:
            name = surface_job.trained_name(scene, name)
        names = [] if self.every else [name]
        return surface_job.spec(scene, names, replace_edits=self.replace_edits)


class ShowSurface(bpy.types.Operator):
    """Show Gaussians, mesh, or both, in viewports and renders"""

    bl_idname = "roigs.show_surface"
    bl_label = "Gaussians, Mesh or Both"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the mesh's object", options=FRESH)
    way: EnumProperty(items=box_surfaces.WAYS, options=FRESH)

    @classmethod
    def description(cls, _: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip."""
        return next(text for way, _, text in box_surfaces.WAYS if way == properties.way)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Hide and show."""
        scene, item = scene_of(context), mesh_named(context, self.name)
        if item is None:
            return failed(self, NO_MESH.format(self.name))
        if box_surfaces.alone(scene):
            box_surfaces.show_all(scene)
        box_surfaces.set_way(scene, item, self.way)
        _select_shown(context, item)
        redraw()
        return {"FINISHED"}


class ShowAlone(bpy.types.Operator):
    """Show this mesh alone, in viewports and renders, with the 3D cursor at its foot: a new plane \
is right below it. A second click shows everything again"""

    bl_idname = "roigs.show_alone"
    bl_label = "Alone"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the mesh's object", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Hide all else, or show it again."""
        scene, item = scene_of(context), mesh_named(context, self.name)
        if item is None:
            return failed(self, NO_MESH.format(self.name))
        if box_surfaces.alone(scene) and not object_props(item).beside:
            box_surfaces.show_all(scene)
        else:
            box_surfaces.show_alone(scene, item)
            view_layer_of(context).update()  # until then, it cannot be selected
            select_only(context, item)
            scene.cursor.location = box_surfaces.foot(item)
            _look_at_selected(context)
        redraw()
        return {"FINISHED"}


class ExportSurface(bpy.types.Operator):
    """Export only this mesh for 3D printing, in millimetres, with Blender's own exporter"""

    bl_idname = "roigs.export_surface"
    bl_label = "Export STL…"

    name: StringProperty(description="Name of the mesh's object", options=FRESH)
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)

    def invoke(self, context: bpy.types.Context, _: bpy.types.Event) -> OperatorResult:
        """Ask Blender's exporter for the file."""
        name = self.name.removesuffix(splats.mesh_name(""))
        return self._export(context, "INVOKE_DEFAULT", bpy.path.clean_name(name) + STL)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Write the file."""
        return self._export(context, "EXEC_DEFAULT", self.filepath)

    def _export(self, context: bpy.types.Context, way: Any, path: str) -> OperatorResult:
        item = mesh_named(context, self.name)
        if item is None:
            return failed(self, NO_MESH.format(self.name))
        if not item.visible_get():
            return failed(self, f"'{self.name}' is hidden. Click Mesh above first.")
        select_only(context, item)
        if not box_surfaces.record(item).get("watertight"):
            self.report(
                {"WARNING"}, "The mesh has holes. For 3D printing, make it again with Watertight"
            )
        bpy.ops.wm.stl_export(
            way,
            filepath=path,
            export_selected_objects=True,
            use_scene_unit=True,
            global_scale=MILLIMETRES,
        )
        return {"FINISHED"}


def mesh_named(context: bpy.types.Context, name: str) -> bpy.types.Object | None:
    """The mesh of a box with this object's full name: that of a linked one names its .blend."""
    found = (item for item in box_surfaces.surfaces(scene_of(context)) if item.name_full == name)
    return next(found, None)


def _look_at_selected(context: bpy.types.Context) -> None:
    """In the 3D view with the button; nothing in scripts."""
    if view_3d_of(context) is None or context.area is None or bpy.app.background:
        return
    regions = (r for r in context.area.regions if r.type == "WINDOW")
    with context.temp_override(region=next(regions)):
        bpy.ops.view3d.view_selected()


def _select_shown(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Keep what the user works on at hand: the mesh for its Gaussians, or these for the mesh."""
    gaussians = box_surfaces.gaussians_of(scene_of(context), item)
    active = view_layer_of(context).objects.active  # the context has no hidden one
    if gaussians is None or active not in (item, gaussians) or not active.hide_viewport:
        return
    view_layer_of(context).update()  # until then, the other one cannot be selected
    select_only(context, gaussians if active == item else item)


register, unregister = registration(MakeSurface, ShowSurface, ShowAlone, ExportSurface)
