"""Step 4, Train."""

from __future__ import annotations

import bpy

from ..blender import layout_of, registration, scene_of
from ..engine.own_files import stage_in_words
from ..engine.run_status import RunStatus
from ..engine.training_steps import training_steps
from ..facts import engine_ability, outdated, run_facts, training_device
from ..jobs import current, estimate_job, run_folders
from ..jobs.spec import ESTIMATING, TRAINING
from ..operators.train import EstimateTime, ShowLog, TrainRoi
from ..properties import scene_props
from ..scene import lookup, masks
from . import layout as show
from .layout import SidebarPanel


class TrainPanel(SidebarPanel):
    """Settings, the button, and where the training is."""

    bl_idname = "ROIGS_PT_train"
    bl_label = "4. Train"

    def draw(self, context: bpy.types.Context) -> None:
        """Show the most important settings, the buttons, and the state of the training."""
        layout, scene = layout_of(self), scene_of(context)
        column = show.setting_column(layout)
        for name in ("preset", "max_side", "made_for"):
            column.prop(scene_props(scene), name)
        _draw_length(layout, scene)
        if device := training_device.of_run(scene):
            show.say(layout, training_device.in_words(device), "SYSTEM")
        status = run_facts.run(scene)
        resume = not current.busy() and status.unfinished
        row = layout.row(align=True)
        text = "Continue" if resume else TrainRoi.bl_label
        row.operator(TrainRoi.bl_idname, text=text, icon="PLAY").resume = resume
        active = lookup.active_roi(context)
        if active is not None and len(lookup.rois(scene)) > 1:
            button = row.operator(TrainRoi.bl_idname, text=f"Only {active.name}")
            button.active_only = True
        row.operator(ShowLog.bl_idname, text="", icon="TEXT")
        if problem := engine_ability.problem():
            show.engine_problem(layout, problem)
        if not show.job(layout, TRAINING) and not show.job(layout, ESTIMATING):
            _draw_status(layout, scene, status)


def _draw_length(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show the number of steps for all boxes, and their time if it was estimated."""
    props = scene_props(scene)
    boxes = max(1, len(lookup.rois(scene)))
    cut_out = masks.are_there(scene, run_folders.run_folder(scene))
    steps = training_steps(props.preset, props.strategy, props.steps_factor, boxes, masks=cut_out)
    length = f"Up to {steps:,} steps" if props.strategy == "joint" else f"{steps:,} steps"
    if time := estimate_job.known(scene):
        show.say(layout, f"{length}, {time}", "TIME")
        return
    row = layout.split(factor=0.62, align=True)
    row.label(text=length, icon="TIME")
    row.operator(EstimateTime.bl_idname)


def _draw_status(layout: bpy.types.UILayout, scene: bpy.types.Scene, status: RunStatus) -> None:
    stages = ", ".join(dict.fromkeys(map(stage_in_words, status.done)))
    changes = "" if status.holder else outdated.in_words(scene, status)
    resumes = "" if changes else ". Continue resumes"
    if status.holder and not current.busy():  # else this Blender's engine holds the folder
        text = f"Another Blender or terminal is training here (process {status.holder})"
        show.paused(layout, text)
    elif status.left:
        show.paused(layout, f"Stopped during: {stage_in_words(status.left)}{resumes}")
    elif status.result and not changes:
        show.done(layout, f"Trained: {stages}" if stages else "Trained")
    elif status.done and not status.result:
        show.paused(layout, f"Stopped after: {stages}{resumes}")
    elif not status.result:
        show.todo(layout, "Not trained yet: click Train")
        return
    if changes:
        show.wrong(layout, changes)
    for old, new in outdated.renamed(scene, status).items():
        show.say(layout, f"'{new}' was trained as '{old}': Train renames its files", "INFO")


class TrainSettingsPanel(SidebarPanel):
    """Settings that are seldom changed."""

    bl_idname = "ROIGS_PT_train_settings"
    bl_parent_id = TrainPanel.bl_idname
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Show steps, strategy, test photos, seed and run folder."""
        layout, scene = layout_of(self), scene_of(context)
        column = show.setting_column(layout)
        props = scene_props(scene)
        for name in ("steps_factor", "strategy"):
            column.prop(props, name)
        show.draw_where(column)
        show.or_number(column, props, "Test Photos", "no_tests", "test_every", "One Photo in")
        for name in ("seed", "run_dir"):
            column.prop(props, name)
        if not props.run_dir:
            show.say(layout, str(run_folders.run_folder(scene)), "FILE_FOLDER")


register, unregister = registration(TrainPanel, TrainSettingsPanel)
