"""Step 5, Result: the surface of a box as a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..blender import registration, scene_of, select_only, view_layer_of
from ..engine.python import FOR_SURFACES
from ..errors import AddonError
from ..facts import run_facts
from ..jobs import current, surface_job
from ..jobs.spec import JobSpec
from ..properties import object_props
from ..scene import box_surfaces, lookup
from ..windows import redraw
from .base import BUSY, FRESH, NO_BOX, EngineOperator, available, failed
from .results import NO_RESULT

if TYPE_CHECKING:
    from ..blender import OperatorResult


class MakeSurface(EngineOperator):
    """Make a mesh with the photos' texture of the object in the active box. It comes into the \
place of the Gaussians; one that was made before is replaced"""

    bl_idname = "roigs.make_surface"
    bl_label = "Make Surface"

    every: BoolProperty(name="All Boxes", description="Of all boxes of the result", options=FRESH)
    replace_edits: BoolProperty(
        name="Replace Edits", description="Also replace meshes that were edited", options=FRESH
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        if current.busy():
            return available(cls, BUSY)
        if not run_facts.run(scene_of(context)).result:
            return available(cls, NO_RESULT)
        return available(cls, "" if lookup.active_roi(context) else NO_BOX)

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that make meshes."""
        return FOR_SURFACES

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make it in the scene's run folder."""
        scene, roi = scene_of(context), lookup.active_roi(context)
        if roi is None:
            raise AddonError(f"{NO_BOX}.")
        names = [] if self.every else [surface_job.trained_name(scene, roi)]
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
        """What the button does."""
        return next(text for way, _, text in box_surfaces.WAYS if way == properties.way)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Hide and show."""
        scene = scene_of(context)
        found = (item for item in box_surfaces.surfaces(scene) if item.name == self.name)
        item = next(found, None)
        if item is None:
            return failed(self, f"There is no mesh '{self.name}'.")
        box_surfaces.set_way(scene, item, self.way)
        _select_shown(context, item)
        redraw()
        return {"FINISHED"}


def _select_shown(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Keep what the user works on at hand: the mesh for its Gaussians, or these for the mesh."""
    gaussians = box_surfaces.gaussians_of(scene_of(context), object_props(item).roi)
    active = view_layer_of(context).objects.active  # the context has no hidden one
    if gaussians is None or active not in (item, gaussians) or not active.hide_viewport:
        return
    view_layer_of(context).update()  # until then, the other one cannot be selected
    select_only(context, gaussians if active == item else item)


register, unregister = registration(MakeSurface, ShowSurface)
