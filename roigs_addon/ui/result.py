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
from ..jobs.spec import ADAPTING, EXPORTING, IMPORTING_GAUSSIANS
from ..operators.adapt import AdaptResult
from ..operators.export import ExportGaussians
from ..operators.import_gaussians import ImportGaussians
from ..operators.native_splats import FromNative, ToNative
from ..operators.results import (
    DeleteResult,
    LoadResults,
    SelectGaussians,
    SetDetail,
    ShowAs,
    ShowInRenders,
    to_get_some,
)
from ..operators.run_folder import CleanUp, CompareResults, FindFolder
from ..properties import SHOWN_AS, object_props, scene_props
from ..scene import (
    carried,
    compared,
    compositor,
    detail,
    display,
    ladders,
    lookup,
    made_for,
    native_splats,
    splats,
)
from ..shared import text
from . import layout as show
from .layout import SidebarPanel

Objects = list[bpy.types.Object]

NAME_SHARE = 0.36
"""Share of a row for the name, beside two buttons; copies differ in the end of their names."""
TRUE_COLOURS = ("Standard", "Raw")
"""View transforms that show the photos' colours."""


class ResultPanel(SidebarPanel):
    """Display of the Gaussians, and pictures of them."""

    bl_idname = "ROIGS_PT_result"
    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Show the buttons, the objects, their problems, the results, and the render."""
        layout, scene = layout_of(self), scene_of(context)
        row = layout.row(align=True)
        row.operator(LoadResults.bl_idname, icon="FILE_REFRESH")
        if run_facts.earlier(scene):  # above the parts that depend on the result
            row.operator(CompareResults.bl_idname, icon="ARROW_LEFTRIGHT")
        items = lookup.splats(scene)
        if not items:
            show.todo(layout, to_get_some(scene))
        names = outdated.renamed(scene, run_facts.run(scene))
        _draw_objects(layout.column(align=True), scene, names)
        _draw_ways(layout, items)
        for path, problem in viewport.problems().items():
            if path and not run_facts.is_file(Path(path)):
                continue  # its points are drawn instead
            named = not path or path in problem
            show.wrong(layout, problem if named else f"{Path(path).name}: {problem}")
        # While it trains, the engine moves files aside.
        if not current.busy() and (lost := len(run_facts.lost_splats(scene))):
            verb, files = ("are", "files are") if lost > 1 else ("is", "file is")
            said = f"{text.counted(lost, 'model')} {verb} drawn from the .blend"
            flat = ", without view-dependent colour" if carried.is_left_out(scene) else ""
            show.say(layout, f"{said}{flat}: the PLY {files} missing", "INFO")
            layout.operator(FindFolder.bl_idname, icon="FILE_FOLDER")
        if not current.busy():
            _draw_made_for(layout, scene)
        _draw_results(layout, scene)
        if items:
            _draw_render(layout, scene)
        row = layout.row(align=True)
        row.operator(ImportGaussians.bl_idname, text="Import…", icon="IMPORT")
        row.operator(ExportGaussians.bl_idname, text="Export…", icon="EXPORT")
        if native_splats.exist():
            row = layout.row(align=True)
            row.operator(ToNative.bl_idname)
            row.operator(FromNative.bl_idname)
        for title in (IMPORTING_GAUSSIANS, EXPORTING, ADAPTING):
            show.job(layout, title)


def _draw_made_for(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show models drawn by another renderer than their target, with the button that adapts them."""
    if found := made_for.mismatch(scene):
        was, wanted = found
        show.wrong(layout, f"Made for {was.title}, not for {wanted.title}")
        label = f"Adapt to {wanted.title}"
        button = layout.operator(AdaptResult.bl_idname, text=label, icon="FILE_REFRESH")
        button.made_for = wanted.name
    if other := made_for.in_other_light(scene):
        name, target = other
        show.wrong(layout, f"'{name}' is made for {target.title}, but drawn like the others")


def _draw_objects(
    layout: bpy.types.UILayout, scene: bpy.types.Scene, names: dict[str, str]
) -> None:
    """Show the background, and the boxes with their copies.

    Args:
        layout: to draw in.
        scene: with the objects.
        names: box -> its present name, if it was renamed.
    """
    for item in lookup.splats(scene):
        props = object_props(item)
        if props.level in ("RESULT", "IMPORTED") and not props.parked:
            row = layout.row(align=True)
            if ladders.of(item, scene) is None:
                _draw_name(row, item, item.name)
            else:
                split = row.split(factor=NAME_SHARE, align=True)
                _draw_name(split, item, item.name)
                row = split.row(align=True)
                whole, buttons = object_props(item).whole, _side_by_side(row, 2)
                _detail_button(buttons, item, "Auto", pressed=not whole, auto=True)
                _detail_button(buttons, item, "Full", pressed=whole)
            row.prop(item, "hide_viewport", text="", emboss=False)
    for pair in detail.pairs(scene):
        if pair.shown is not None:
            levels = pair.fine is not None and ladders.of(pair.fine, scene) is not None
            _draw_pair(layout, pair, names, levels=levels)


def _draw_pair(
    layout: bpy.types.UILayout, pair: detail.Pair, names: dict[str, str], *, levels: bool
) -> None:
    shown = pair.shown
    assert shown is not None
    props = object_props(shown)
    own = shown.name != splats.object_name(props.level, props.roi)  # a copy, or renamed
    name = shown.name if own else names.get(props.roi, props.roi)
    if levels:  # beside the name, labels of three buttons would be cut
        _draw_name(layout, shown, name)
        row = layout.row(align=True)
    else:
        split = layout.split(factor=NAME_SHARE, align=True)
        _draw_name(split, shown, name)
        row = split.row(align=True)
    fine, buttons = shown == pair.fine, _side_by_side(row, 2 + levels)
    whole = fine and (props.whole or not levels)
    if levels:
        _detail_button(buttons, shown, "Auto", pressed=fine and not whole, auto=True)
    _detail_button(buttons, shown, "Result", pressed=whole)
    _detail_button(buttons, shown, "First pass", pressed=not fine, fine=False)
    row.prop(shown, "hide_viewport", text="", emboss=False)


def _side_by_side(row: bpy.types.UILayout, count: int) -> bpy.types.UILayout:
    """Return a layout for buttons of one width. In a row, Blender hides some at some widths."""
    return row.grid_flow(row_major=True, columns=count, even_columns=True, align=True)


def _detail_button(
    row: bpy.types.UILayout,
    item: bpy.types.Object,
    label: str,
    *,
    pressed: bool,
    fine: bool = True,
    auto: bool = False,
) -> None:
    button = row.operator(SetDetail.bl_idname, text=label, depress=pressed)
    button.name, button.fine, button.auto = item.name_full, fine, auto


def _draw_name(row: bpy.types.UILayout, item: bpy.types.Object, name: str) -> None:
    """Show the name as a button that selects the object."""
    button = row.operator(SelectGaussians.bl_idname, text=name, depress=item.select_get())
    button.name = item.name_full


def _draw_ways(layout: bpy.types.UILayout, splats: Objects) -> None:
    """Show the choice of the Gaussians' display."""
    if not splats:
        return
    row, now = layout.row(align=True), object_props(splats[0]).shown_as
    for way, label, _ in SHOWN_AS:
        if way != "EXACT" or native_splats.exist():
            row.operator(ShowAs.bl_idname, text=label, depress=now == way).way = way


def _draw_results(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show the last and the earlier results with settings, PSNR, date and size, and disk use."""
    results, shown = run_facts.earlier(scene), compared.shown_result(scene)
    last = run_facts.result(scene)
    if run_facts.run(scene).result and (results or last.psnr):
        said = ", ".join(filter(None, (run_settings.title(last.settings), last.psnr)))
        show.say(layout, f"Last result: {said}" if said else "Last result", "INFO")
    if results:
        column = layout.column(align=True)
        size = text.in_gb(sum(result.size for result in results))
        column.label(text=f"Earlier results, {size} in total")
    sides = {result.settings.max_side for result in results if result.psnr}
    if last.psnr:
        sides.add(last.settings.max_side)
    if len(sides) > 1:
        show.say(layout, "Compare PSNR only at the same photo size", "INFO")
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
        part = text.in_gb(disk.removable) if disk.removable else "0"
        label = f"{CleanUp.bl_label} ({part} of {text.in_gb(disk.total)})"
        layout.operator(CleanUp.bl_idname, text=label, icon="BRUSH_DATA")
    if shown is not None:
        layout.prop(scene_props(scene), "carry_colour")


def _draw_render(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show Blender's render buttons, and problems of the Gaussians or their colours in renders."""
    if layer := display.in_layer(scene):
        problem = compositor.lacking(scene) or rendering.problem
        if problem:
            show.wrong(layout, problem)
    if layer and compositor.find(scene) is None:
        layout.operator(ShowInRenders.bl_idname, icon="RENDER_STILL")
    view = scene.view_settings
    if view is not None and view.view_transform not in TRUE_COLOURS:
        show.todo(layout, "For the photos' colours, choose the Standard view transform")
        layout.prop(view, "view_transform")
    row = layout.row(align=True)
    row.operator("render.render", text="Render", icon="RENDER_STILL").use_viewport = True
    button = row.operator("render.render", text="Animation", icon="RENDER_ANIMATION")
    button.animation = button.use_viewport = True


register, unregister = registration(ResultPanel)
