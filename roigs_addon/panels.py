"""The sidebar tab «ROI-GS»: the steps in the order of the work. Layout only.

Drawn again at every event, so everything that would cost time is asked of `facts` and `counts`.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import bpy

from . import counts, facts, jobs, lookup, preferences, requests, run_folders, viewport
from .engine.runs import stage_in_words
from .operators import results, train
from .operators.regions import AddRoi, LoadRois, RemoveRoi, SelectRoi
from .operators.scene import ImportColmap, LookThrough
from .operators.select import EditSelection, SelectCameras
from .photo import Photo

DONE, MISSING, WRONG, PAUSED = "CHECKMARK", "RADIOBUT_OFF", "ERROR", "PAUSE"
PIXELS_PER_LETTER = 7.5
"""Of Blender's default font, at a scale of 1."""


class _Panel:
    """What all panels of the tab have in common."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ROI-GS"


def _say(layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """A text, in lines that fit the sidebar."""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
    letters = int(region.width / (PIXELS_PER_LETTER * scale)) - 5 if region else 40
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, max(letters, 20))):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


def _job(layout: bpy.types.UILayout, title: str) -> bool:
    """The progress or the error of this step's job; False when there is neither."""
    state = bpy.context.window_manager.roigs
    if state.title != title:
        return False
    if jobs.busy():
        _progress(layout, state)
        return True
    if state.error:
        _say(layout, state.error, WRONG)
        layout.operator(train.ShowLog.bl_idname, icon="TEXT")
    return bool(state.error)


def _progress(layout: bpy.types.UILayout, state: bpy.types.PropertyGroup) -> None:
    share = state.step / state.total if state.total else 0.0
    stage = stage_in_words(state.stage) if state.stage else ""
    row = layout.row(align=True)
    percent = f" {share:.0%}" if state.total else " …"
    row.progress(factor=share, text=f"{state.title}{': ' if stage else ''}{stage}{percent}")
    row.operator(train.StopJob.bl_idname, text="", icon="CANCEL")
    column = layout.column(align=True)
    if state.total:
        left = jobs.time_text(state.seconds_left).removeprefix(", ")
        column.label(text=f"Step {state.step:,} of {state.total:,}")
        if left:
            column.label(text=f"About {left} in this stage")
    if state.gaussians:
        column.label(text=f"{state.gaussians:,} Gaussians")
    if state.psnr:
        column.label(text=f"PSNR {state.psnr:.1f} dB, loss {state.loss:.3f}")
    if state.message:
        _say(column, state.message, "INFO")
    if jobs.current.hears_esc and not jobs.current.stopping:
        column.label(text="Esc stops and keeps what is done", icon="BLANK1")


class ScenePanel(_Panel, bpy.types.Panel):
    """Step 1."""

    bl_idname = "ROIGS_PT_scene"
    bl_label = "1. Scene"

    def draw(self, context: bpy.types.Context) -> None:
        """The model and its cameras."""
        layout, scene = self.layout, context.scene
        settings = scene.roigs
        layout.operator(ImportColmap.bl_idname, icon="IMPORT")
        if _job(layout, "Importing"):
            return
        if not settings.colmap:
            _say(layout, "Missing: the folder of a COLMAP project", MISSING)
            return
        photos = facts.photos(scene)
        cloud = lookup.points(scene)
        points = len(cloud.data.vertices) if cloud else 0
        project = Path(settings.colmap).name
        _say(layout, f"{project}: {photos:,} photos, {points:,} points", DONE)
        if settings.skipped:
            _say(layout, f"Left out: {settings.skipped}", WRONG)
        row = layout.row(align=True)
        name = _photo_at_hand(context)
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_LEFT").step = -1
        row.operator(LookThrough.bl_idname, text=name, icon="CAMERA_DATA").step = 0
        row.operator(LookThrough.bl_idname, text="", icon="TRIA_RIGHT").step = 1


def _photo_at_hand(context: bpy.types.Context) -> str:
    item = lookup.camera_at_hand(context)
    photo = Photo.from_json(item.roigs.photo) if item else None
    return facts.short_name(context.scene, photo.name) if photo else "Look Through"


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
        row.operator(LoadRois.bl_idname, text="", icon="FILE_FOLDER")
        boxes = lookup.rois(scene)
        if not boxes:
            _say(layout, "Missing: a box around each object that shall be sharp", MISSING)
            return
        active = lookup.active_roi(context)
        for roi in boxes:
            column = layout.box().column(align=True)
            row = column.row(align=True)
            icon = "RADIOBUT_ON" if roi == active else "RADIOBUT_OFF"
            row.operator(SelectRoi.bl_idname, text="", icon=icon, emboss=False).name = roi.name
            row.prop(roi, "name", text="")
            row.prop(roi, "hide_viewport", text="", emboss=False)
            _describe(column, roi, scene)


def _describe(layout: bpy.types.UILayout, roi: bpy.types.Object, scene: bpy.types.Scene) -> None:
    found = counts.count_soon(roi, scene)
    if found is None:
        _say(layout, "Slanted or flat: see its rotation and size", WRONG)
        return
    points, photos = found
    if not points:
        _say(layout, "Empty: no point of the model is in it", WRONG)
        return
    seen = "" if photos is None else f", seen in {photos:,} photos"
    _say(layout, f"{points:,} points{seen}", DONE)


class PlacePanel(_Panel, bpy.types.Panel):
    """The active box by numbers."""

    bl_idname = "ROIGS_PT_place"
    bl_parent_id = RegionsPanel.bl_idname
    bl_label = "Place and Size"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return lookup.active_roi(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Where it is, how it is turned, half its sides."""
        layout, roi = self.layout, lookup.active_roi(context)
        layout.label(text=roi.name)
        for name, text in (("location", "Centre"), ("scale", "Half Side")):
            layout.column().prop(roi, name, text=text)
        turned = "rotation_quaternion" if roi.rotation_mode == "QUATERNION" else "rotation_euler"
        layout.column().prop(roi, turned, text="Rotation")


class PhotoList(bpy.types.UIList):
    """The photos of a box, best first."""

    bl_idname = "ROIGS_UL_photos"

    def draw_item(
        self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0
    ) -> None:
        """Name, the score as a bar, and a button that looks through the camera."""
        split = layout.split(factor=0.55, align=True)
        split.label(text=f"{index + 1}  {facts.short_name(context.scene, item.name)}")
        row = split.row(align=True)
        if item.score:
            row.progress(factor=min(max(item.score, 0.0), 1.0), text=f"{item.score:.2f}")
        else:
            row.label(text="by hand")
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
        column.use_property_decorate = False
        column.prop(scene.roigs, "method")
        automatic = not scene.roigs.count
        column.prop(scene.roigs, "count", text="Photos (auto)" if automatic else "Photos")
        layout.operator(SelectCameras.bl_idname, icon="CAMERA_DATA")
        roi = lookup.active_roi(context)
        if _job(layout, "Selecting"):
            return
        if roi is None:
            _say(layout, "Missing: a box", MISSING)
            return
        chosen = roi.roigs.selection
        if not len(chosen):
            _say(layout, f"{roi.name}: will be chosen when training", MISSING)
        elif requests.selection_is_stale(roi, scene):
            _say(layout, f"{roi.name} was moved since: select again", WRONG)
        else:
            _say(layout, f"{roi.name}: {len(chosen)} photos, best first", DONE)
        if len(chosen):
            _list(layout, roi)
        else:
            layout.operator(
                EditSelection.bl_idname, text="Add Selected Cameras", icon="ADD"
            ).action = "ADD"


def _list(layout: bpy.types.UILayout, roi: bpy.types.Object) -> None:
    row = layout.row()
    row.template_list(
        PhotoList.bl_idname, "", roi.roigs, "selection", roi.roigs, "selection_index", rows=5
    )
    column = row.column(align=True)
    icons = {"ADD": "ADD", "REMOVE": "REMOVE", "UP": "TRIA_UP", "DOWN": "TRIA_DOWN", "CLEAR": "X"}
    for action, icon in icons.items():
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
        column.use_property_decorate = False
        for name in ("preset", "max_side"):
            column.prop(scene.roigs, name)
        found = facts.run(scene)
        go_on = not jobs.busy() and found.begun
        row = layout.row(align=True)
        text = "Continue" if go_on else "Train ROI"
        row.operator(train.TrainRoi.bl_idname, text=text, icon="PLAY").go_on = go_on
        active = lookup.active_roi(context)
        if active is not None and len(lookup.rois(scene)) > 1:
            button = row.operator(train.TrainRoi.bl_idname, text=f"Only {active.name}")
            button.active_only = True
        row.operator(train.ShowLog.bl_idname, text="", icon="TEXT")
        if problem := facts.engine_problem():
            _engine_missing(layout, problem)
        if not _job(layout, "Training"):
            self._state(layout, scene, found)

    def _state(self, layout, scene, found) -> None:
        if found.holder:
            text = f"Another Blender or terminal is training here (process {found.holder})"
            _say(layout, text, PAUSED)
        elif found.left:
            _say(layout, f"Stopped: {stage_in_words(found.left)}", PAUSED)
        elif found.result and (moved := facts.changed(scene, found)):
            _say(layout, f"Not trained as they are now: {', '.join(moved)}", WRONG)
        elif found.result:
            _say(layout, f"Trained: {', '.join(map(stage_in_words, found.done))}", DONE)
        elif found.done:
            _say(layout, f"Stopped after: {', '.join(map(stage_in_words, found.done))}", PAUSED)
        else:
            _say(layout, "Not trained yet", MISSING)


def _engine_missing(layout: bpy.types.UILayout, problem: str) -> None:
    box = layout.box()
    _say(box, problem, WRONG)
    box.operator(
        "preferences.addon_show", text="Set Up the Engine", icon="PREFERENCES"
    ).module = preferences.ADDON


class TrainSettingsPanel(_Panel, bpy.types.Panel):
    """What is seldom changed."""

    bl_idname = "ROIGS_PT_train_settings"
    bl_parent_id = TrainPanel.bl_idname
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Steps, boxes, tests, folder."""
        layout, scene = self.layout, context.scene
        column = layout.column(align=True)
        column.use_property_split = True
        column.use_property_decorate = False
        for name in ("steps_factor", "strategy", "test_every", "seed", "run_dir"):
            column.prop(scene.roigs, name)
        if not scene.roigs.run_dir:
            _say(layout, f"{run_folders.run_folder(scene)}", "FILE_FOLDER")


class ResultPanel(_Panel, bpy.types.Panel):
    """Step 5."""

    bl_idname = "ROIGS_PT_result"
    bl_label = "5. Result"

    def draw(self, context: bpy.types.Context) -> None:
        """What is shown of the Gaussians, and pictures of them."""
        layout, scene = self.layout, context.scene
        layout.operator(results.LoadResults.bl_idname, icon="FILE_REFRESH")
        splats = lookup.splats(scene)
        if not splats:
            _say(layout, "Missing: Gaussians; train first", MISSING)
        column = layout.column(align=True)
        levels = results.box_levels(scene)
        for item in splats:
            if item.roigs.level == "RESULT":
                row = column.row(align=True)
                row.label(text=item.name)
                row.prop(item, "hide_viewport", text="", emboss=False)
            elif item.roigs.level == "ROI":
                self._box(column.row(align=True), splats, item.roigs.roi, levels)
        drawn = [item for item in splats if item.type == "MESH"]  # Blender draws its own kind
        if drawn:
            row = layout.row(align=True)
            as_points = drawn[0].roigs.as_points
            for text, value in (("Gaussians", False), ("Points", True)):
                button = row.operator(
                    results.ShowPoints.bl_idname, text=text, depress=as_points == value
                )
                button.points = value
        for path, problem in viewport.problems().items():
            _say(layout, f"{Path(path).name}: {problem}" if path else problem, WRONG)
        if not jobs.busy() and (gone := facts.gone(scene)):  # a training puts files away
            text = (
                f"Files not found: {', '.join(gone)}. Train, or set the Run Folder and load results"
            )
            _say(layout, text, WRONG)
        if _job(layout, "Rendering"):
            return
        row = layout.row(align=True)
        for text, icon, value in (
            ("Render", "RENDER_STILL", False),
            ("Animation", "RENDER_ANIMATION", True),
        ):
            button = row.operator(results.RenderSplats.bl_idname, text=text, icon=icon)
            button.animation = value

    def _box(self, row, splats, roi, levels) -> None:
        row.label(text=roi)
        for text, fine in (("Coarse", False), ("Fine", True)):
            pressed = levels[roi] == fine
            button = row.operator(results.SetDetail.bl_idname, text=text, depress=pressed)
            button.roi, button.fine = roi, fine
        shown = "ROI" if levels[roi] else "SCENE"
        for item in splats:
            if item.roigs.roi == roi and item.roigs.level == shown:
                row.prop(item, "hide_viewport", text="", emboss=False)


CLASSES = (
    *(PhotoList, ScenePanel, RegionsPanel, PlacePanel, CamerasPanel),
    *(TrainPanel, TrainSettingsPanel, ResultPanel),
)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
