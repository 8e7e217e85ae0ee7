"""The sidebar tab «ROI-GS»: the steps in the order of the work. Layout only."""

from __future__ import annotations

import textwrap
from pathlib import Path

import bpy

from . import counts, jobs, lookup, requests
from .operators import results, train
from .operators.regions import AddRoi, RemoveRoi, SelectRoi
from .operators.scene import ImportColmap, LookThrough
from .operators.select import EditSelection, SelectCameras
from .photo import Photo

DONE, MISSING = "CHECKMARK", "RADIOBUT_OFF"


class _Panel:
    """What all panels of the tab have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ROI-GS"


def _state(layout: bpy.types.UILayout, done: bool, text: str) -> None:
    layout.label(text=text, icon=DONE if done else MISSING)


class ScenePanel(_Panel, bpy.types.Panel):
    """Step 1."""

    bl_idname = "ROIGS_PT_scene"
    bl_label = "1. Scene"

    def draw(self, context: bpy.types.Context) -> None:
        """The model and its cameras."""
        layout, scene = self.layout, context.scene
        settings = scene.roigs
        layout.operator(ImportColmap.bl_idname, icon="IMPORT")
        if not settings.colmap:
            _state(layout, False, "No COLMAP model yet")
            return
        cameras = sum(1 for _ in lookup.of_kind(scene, "CAMERA"))
        cloud = lookup.points(scene)
        found = len(cloud.data.vertices) if cloud else 0
        _state(layout, True, f"{Path(settings.colmap).name}: {cameras:,} photos, {found:,} points")
        if settings.skipped:
            layout.label(text=f"Left out: {settings.skipped}", icon="ERROR")
        row = layout.row(align=True)
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_LEFT").step = -1
        row.operator(LookThrough.bl_idname, text=_active_photo(scene))
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_RIGHT").step = 1


def _active_photo(scene: bpy.types.Scene) -> str:
    photo = Photo.from_json(scene.camera.roigs.photo) if scene.camera else None
    return photo.name if photo else "Look Through"


class RegionsPanel(_Panel, bpy.types.Panel):
    """Step 2."""

    bl_idname = "ROIGS_PT_regions"
    bl_label = "2. Regions"

    def draw(self, context: bpy.types.Context) -> None:
        """The boxes, with what is in them."""
        layout, scene = self.layout, context.scene
        row = layout.row(align=True)
        row.operator(AddRoi.bl_idname, icon="ADD")
        row.operator(RemoveRoi.bl_idname, text="", icon="REMOVE")
        boxes = lookup.rois(scene)
        if not boxes:
            _state(layout, False, "Add a box around each object")
            return
        active = lookup.active_roi(context)
        for roi in boxes:
            column = layout.box().column(align=True)
            row = column.row(align=True)
            icon = "RADIOBUT_ON" if roi == active else "RADIOBUT_OFF"
            row.operator(SelectRoi.bl_idname, text="", icon=icon, emboss=False).name = roi.name
            row.prop(roi, "name", text="")
            row.prop(roi, "hide_viewport", text="", emboss=False)
            self._describe(column, roi, scene)
            if roi == active:
                column.prop(roi, "location")
                column.prop(roi, "rotation_euler")
                column.prop(roi, "scale")

    def _describe(
        self, layout: bpy.types.UILayout, roi: bpy.types.Object, scene: bpy.types.Scene
    ) -> None:
        found = counts.count(roi, scene)
        if found is None:
            layout.label(text="This is no box: see its scale and rotation", icon="ERROR")
            return
        points, photos = found
        seen = "" if photos is None else f", seen in {photos:,} photos"
        layout.label(text=f"{points:,} points{seen}", icon="NONE" if points else "ERROR")


class PhotoList(bpy.types.UIList):
    """The photos of a box, best first."""

    bl_idname = "ROIGS_UL_photos"

    def draw_item(
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        """Name, score, and a button that looks through the camera."""
        row = layout.row(align=True)
        row.label(text=f"{index + 1}  {item.name}")
        row.label(text=f"{item.score:.3f}" if item.score else "")
        row.operator(LookThrough.bl_idname, text="", icon="HIDE_OFF").photo = item.name


class CamerasPanel(_Panel, bpy.types.Panel):
    """Step 3."""

    bl_idname = "ROIGS_PT_cameras"
    bl_label = "3. Cameras"

    def draw(self, context: bpy.types.Context) -> None:
        """How to select, and what was selected for the active box."""
        layout, scene = self.layout, context.scene
        column = layout.column(align=True)
        column.use_property_split = True
        column.prop(scene.roigs, "method")
        column.prop(scene.roigs, "count")
        layout.operator(SelectCameras.bl_idname, icon="CAMERA_DATA")
        roi = lookup.active_roi(context)
        if roi is None:
            _state(layout, False, "Add a box first")
            return
        chosen = roi.roigs.selection
        if not len(chosen):
            _state(layout, False, f"{roi.name}: the engine will choose when training")
        elif requests.selection_is_stale(roi, scene):
            layout.label(text=f"{roi.name} was moved since: select again", icon="ERROR")
        else:
            _state(layout, True, f"{roi.name}: {len(chosen)} photos")
        if len(chosen):
            self._list(layout, roi)

    def _list(self, layout: bpy.types.UILayout, roi: bpy.types.Object) -> None:
        row = layout.row()
        row.template_list(
            PhotoList.bl_idname, "", roi.roigs, "selection", roi.roigs, "selection_index", rows=4
        )
        column = row.column(align=True)
        icons = {"ADD": "ADD", "REMOVE": "REMOVE", "UP": "TRIA_UP", "DOWN": "TRIA_DOWN"}
        for action, icon in {**icons, "CLEAR": "X"}.items():
            column.operator(EditSelection.bl_idname, text="", icon=icon).action = action


class TrainPanel(_Panel, bpy.types.Panel):
    """Step 4."""

    bl_idname = "ROIGS_PT_train"
    bl_label = "4. Train"

    def draw(self, context: bpy.types.Context) -> None:
        """Settings, the button, and where the engine is."""
        layout, scene = self.layout, context.scene
        column = layout.column(align=True)
        column.use_property_split = True
        for name in ("preset", "steps_factor", "max_side", "run_dir"):
            column.prop(scene.roigs, name)
        left = "" if jobs.busy() else train.unfinished(scene)
        text = "Continue" if left else "Train ROI"
        layout.operator(train.TrainRoi.bl_idname, text=text, icon="PLAY")
        state = context.window_manager.roigs
        if jobs.busy():
            self._progress(layout, state)
        elif state.error:
            _wrapped(layout, state.error, "ERROR")
        elif left:
            layout.label(text=f"Stopped in stage «{left}»", icon="PAUSE")
        elif done := train.finished(scene):
            _state(layout, True, f"Trained: {', '.join(done)}")
        else:
            _state(layout, False, "Not trained yet")
        if train.log_path(context):
            layout.operator(train.ShowLog.bl_idname, icon="TEXT")

    def _progress(self, layout: bpy.types.UILayout, state: bpy.types.PropertyGroup) -> None:
        share = state.step / state.total if state.total else 0.0
        text = f"{state.stage or state.title} {share:.0%}"
        row = layout.row(align=True)
        if hasattr(row, "progress"):
            row.progress(factor=share, text=text)
        else:
            row.label(text=text)
        row.operator(train.StopJob.bl_idname, text="", icon="CANCEL")
        column = layout.column(align=True)
        if state.total:
            column.label(
                text=f"Step {state.step:,} of {state.total:,}{jobs.time_text(state.seconds_left)}"
            )
        if state.gaussians:
            column.label(
                text=f"{state.gaussians:,} Gaussians, {state.psnr:.1f} dB, loss {state.loss:.4f}"
            )
        if state.message:
            column.label(text=state.message)


def _wrapped(layout: bpy.types.UILayout, text: str, icon: str, width: int = 46) -> None:
    """A text in lines that fit the sidebar."""
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


class ResultPanel(_Panel, bpy.types.Panel):
    """Step 5."""

    bl_idname = "ROIGS_PT_result"
    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        """What is shown of the Gaussians, and pictures of them."""
        layout, scene = self.layout, context.scene
        layout.operator(results.LoadResults.bl_idname, icon="FILE_REFRESH")
        levels = results.box_levels(scene)
        if not levels:
            _state(layout, False, "No Gaussians in the scene yet")
        for roi, fine in levels.items():
            row = layout.row(align=True)
            row.label(text=roi)
            for text, value in (("Coarse", False), ("Fine", True)):
                button = row.operator(results.SetDetail.bl_idname, text=text, depress=fine == value)
                button.roi, button.fine = roi, value
        if levels:
            row = layout.row(align=True)
            for text, value in (("Points", True), ("Gaussians", False)):
                row.operator(results.ShowPoints.bl_idname, text=text).points = value
        row = layout.row(align=True)
        row.operator(results.RenderSplats.bl_idname, text="Render", icon="RENDER_STILL")
        row.operator(
            results.RenderSplats.bl_idname, text="Animation", icon="RENDER_ANIMATION"
        ).animation = True


CLASSES = (PhotoList, ScenePanel, RegionsPanel, CamerasPanel, TrainPanel, ResultPanel)


def register() -> None:
    """The panels, in their order."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """The reverse."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
