"""Step 5, Result."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from .. import rendering, viewport
from ..blender import layout_of, registration, scene_of
from ..engine import run_settings
from ..facts import outdated, run_facts
from ..jobs import current
from ..jobs.spec import EXPORTING
from ..operators.export import ExportGaussians
from ..operators.results import (
    DeleteResult,
    LoadResults,
    SelectGaussians,
    SetDetail,
    ShowPoints,
)
from ..operators.run_folder import CleanUp, CompareResults
from ..properties import object_props
from ..scene import compared, compositor, lookup
from ..scene.splats import shown_levels
from ..shared import text
from . import layout as show
from .layout import SidebarPanel

Objects = list[bpy.types.Object]

NAMED = 2
"""Missing files that are named."""
TRUE_COLOURS = ("Standard", "Raw")
"""View transforms that show the photos' colours."""


class ResultPanel(SidebarPanel):
    """What is shown of the Gaussians, and pictures of them."""

    bl_idname = "ROIGS_PT_result"
    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Import, the objects, what is wrong with them, render."""
        layout, scene = layout_of(self), scene_of(context)
        layout.operator(LoadResults.bl_idname, icon="FILE_REFRESH")
        splats = lookup.splats(scene)
        if not splats:
            show.todo(layout, "Train first to get Gaussians")
        names = outdated.renamed(scene, run_facts.run(scene))
        _draw_objects(layout.column(align=True), splats, shown_levels(scene), names)
        _draw_as_points(layout, splats)
        for path, problem in viewport.problems().items():
            if path and not run_facts.is_file(Path(path)):
                continue  # the next line says it
            named = not path or path in problem
            show.wrong(layout, problem if named else f"{Path(path).name}: {problem}")
        # While it trains, the engine archives files.
        if not current.busy() and (missing := run_facts.missing_splats(scene)):
            more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
            listed = ", ".join(missing[:NAMED]) + more
            show.wrong(layout, f"Missing splat files: {listed}. Set the Run Folder, or train")
        _draw_results(layout, scene)
        if splats:
            _draw_render(layout, scene)
            layout.operator(ExportGaussians.bl_idname, text="Export…", icon="EXPORT")
            show.job(layout, EXPORTING)


def _draw_objects(
    layout: bpy.types.UILayout, splats: Objects, levels: dict[str, bool], names: dict[str, str]
) -> None:
    """The background and the boxes.

    Args:
        layout, splats: where, and the objects.
        levels: box -> whether it is shown refined.
        names: box -> its name now, if it was renamed.
    """
    for item in splats:
        props = object_props(item)
        if props.parked:  # in another result
            continue
        row = layout.row(align=True)
        if props.level == "RESULT":
            _draw_name(row, item, item.name)
            row.prop(item, "hide_viewport", text="", emboss=False)
        elif props.level == "ROI":
            name = names.get(props.roi, props.roi)
            _draw_box(row, splats, props.roi, name, refined=levels[props.roi])


def _draw_box(
    row: bpy.types.UILayout, splats: Objects, roi: str, name: str, *, refined: bool
) -> None:
    shown = "ROI" if refined else "SCENE"
    items = [i for i in splats if object_props(i).roi == roi and object_props(i).level == shown]
    if items:
        _draw_name(row, items[0], name)
    for label, fine in (("Coarse", False), ("Fine", True)):
        button = row.operator(SetDetail.bl_idname, text=label, depress=refined == fine)
        button.roi, button.fine = roi, fine
    for item in items:
        row.prop(item, "hide_viewport", text="", emboss=False)


def _draw_name(row: bpy.types.UILayout, item: bpy.types.Object, name: str) -> None:
    """The name as a button that selects the object."""
    button = row.operator(SelectGaussians.bl_idname, text=name, depress=item.select_get())
    button.name = item.name


def _draw_as_points(layout: bpy.types.UILayout, splats: Objects) -> None:
    drawn = [item for item in splats if item.type == "MESH"]  # Blender draws its own kind
    if not drawn:
        return
    row = layout.row(align=True)
    as_points = object_props(drawn[0]).as_points
    for label, points in (("Gaussians", False), ("Points", True)):
        button = row.operator(ShowPoints.bl_idname, text=label, depress=as_points == points)
        button.points = points


def _draw_results(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """The last result and those that it has replaced: settings, PSNR, day, size; disk use."""
    results, shown = run_facts.earlier(scene), compared.shown_result(scene)
    last = run_facts.result(scene)
    if run_facts.run(scene).result and (results or last.psnr):
        said = ", ".join(filter(None, (run_settings.title(last.settings), last.psnr)))
        show.say(layout, f"Last result: {said}" if said else "Last result", "INFO")
    if results:
        column = layout.column(align=True)
        column.operator(CompareResults.bl_idname, icon="ARROW_LEFTRIGHT")
        size = text.in_gb(sum(result.size for result in results))
        column.label(text=f"Earlier results, {size} in total")
    sides = {result.settings.max_side for result in results if result.psnr}
    if last.psnr:
        sides.add(last.settings.max_side)
    if len(sides) > 1:
        show.say(layout, "PSNR compares results of one photo size only", "INFO")
    for result in results:
        made = time.strftime("%d %b %Y, %H:%M", time.localtime(result.made))
        title = run_settings.title(result.settings)
        row = column.row(align=True)
        button = row.operator(
            LoadResults.bl_idname, text=title or made, depress=shown == result.folder
        )
        button.earlier = result.folder.name
        row.operator(DeleteResult.bl_idname, text="", icon="TRASH").earlier = result.folder.name
        parts = (result.psnr, made if title else "", text.in_gb(result.size))
        show.say(column, ", ".join(part for part in parts if part), "BLANK1")
    disk = run_facts.disk(scene)
    if disk.total:
        row = layout.row(align=True)
        row.label(text=f"Run folder: {text.in_gb(disk.total)}")
        size = f" ({text.in_gb(disk.removable)})" if disk.removable else ""
        label = f"{CleanUp.bl_label}{size}"
        row.operator(CleanUp.bl_idname, text=label, icon="BRUSH_DATA")


def _draw_render(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Blender's own render, and what keeps the Gaussians out of it or changes their colours."""
    problem = compositor.lacking(scene) or rendering.problem
    if problem:
        show.wrong(layout, problem)
    view = scene.view_settings
    if view is not None and view.view_transform not in TRUE_COLOURS:
        show.todo(layout, "For the photos' colours, choose the Standard view transform")
        layout.prop(view, "view_transform")
    row = layout.row(align=True)
    row.operator("render.render", text="Render", icon="RENDER_STILL").use_viewport = True
    button = row.operator("render.render", text="Animation", icon="RENDER_ANIMATION")
    button.animation = button.use_viewport = True


register, unregister = registration(ResultPanel)
