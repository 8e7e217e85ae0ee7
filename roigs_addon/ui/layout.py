"""Code shared by all panels of the tab."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import bpy

from .. import blender, settings
from ..engine.own_files import stage_in_words, step_in_words, warning_in_words
from ..jobs import current
from ..jobs.spec import RESUMED, TRAINING
from ..jobs.state import JobState
from ..operators import train
from ..shared import text as texts

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

PIXELS_PER_LETTER = 7.5
"""Mean width of a letter of Blender's default font, at an interface scale of 1."""


LONGEST = 2000
"""Most letters shown of a text."""


class SidebarPanel(bpy.types.Panel):
    """Base of the panels of the tab 'ROI-GS'."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ROI-GS"


def say(layout: bpy.types.UILayout, text: str, icon: IconItems) -> None:
    """Show a text, wrapped to fit the sidebar."""
    region = bpy.context.region
    scale = PIXELS_PER_LETTER * blender.interface_scale()
    letters = int(region.width / scale) - 5 if region else 40
    wrapped(layout, text, icon, max(letters, 20))


def wrapped(layout: bpy.types.UILayout, text: str, icon: IconItems, letters: int) -> None:
    """Show a text in lines of so many letters, with an icon before the first one.

    It may contain untrusted names, so unprintable characters are removed, and its length is
    limited.
    """
    column = layout.column(align=True)
    shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
    shown = texts.printable(" ".join(shown.split())).encode("utf-8", "backslashreplace").decode()
    for number, line in enumerate(textwrap.wrap(shown, letters)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


def done(layout: bpy.types.UILayout, text: str) -> None:
    """Show something that is done."""
    say(layout, text, "CHECKMARK")


def todo(layout: bpy.types.UILayout, text: str) -> None:
    """Show something that the user has to do next."""
    say(layout, text, "RADIOBUT_OFF")


def wrong(layout: bpy.types.UILayout, text: str) -> None:
    """Show a problem."""
    say(layout, text, "ERROR")


def paused(layout: bpy.types.UILayout, text: str) -> None:
    """Show something that was stopped or waits."""
    say(layout, text, "PAUSE")


def setting_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Return a column for settings with their names on the left."""
    column = layout.column(align=True)
    column.use_property_split = True
    column.use_property_decorate = False
    return column


def or_number(
    layout: bpy.types.UILayout, owner: Any, heading: str, none: str, number: str, text: str = ""
) -> None:
    """Show a check box that means 0, and the number if it is off; see `properties.zero`."""
    layout.column(heading=heading, align=True).prop(owner, none)
    if not getattr(owner, none):
        layout.prop(owner, number, text=text or "Number")


def engine_problem(layout: bpy.types.UILayout, problem: str) -> None:
    """Show why the engine cannot train, and the button that opens its set-up."""
    box = layout.box()
    if settings.chosen_python():
        wrong(box, problem)
    else:  # the preferences list the missing packages
        todo(box, "Training needs the engine: set it up once, in the preferences")
    button = box.operator("preferences.addon_show", text="Set Up the Engine", icon="PREFERENCES")
    button.module = settings.ADDON


def job(layout: bpy.types.UILayout, title: str) -> bool:
    """Show the state of the job of this title; return whether it runs or has failed."""
    state = current.state()
    ours = state.title == title
    if ours and current.busy():
        progress(layout, state)
    for text in current.warnings(title):
        wrong(layout, warning_in_words(text))
    if not ours:
        return False
    if current.busy():
        return True
    if state.error:
        wrong(layout, state.error)
        layout.operator(train.ShowLog.bl_idname, icon="TEXT")
    elif outcome := current.outcome():
        done(layout, outcome)
    elif current.stopped() and title != TRAINING:  # for a training, the run folder says more
        paused(layout, state.message)
    return bool(state.error)


def progress(layout: bpy.types.UILayout, state: JobState) -> None:
    """Show a running job: bar, stop button, numbers."""
    share = state.step / state.total if state.total else 0.0
    # Title and stage together are wider than the sidebar's initial width.
    named = stage_in_words(state.stage) if state.stage else state.title
    percent = f" {share:.0%}" if state.total else " …"
    row = layout.row(align=True)
    row.progress(factor=share, text=f"{named[0].upper()}{named[1:]}{percent}")
    row.operator(train.StopJob.bl_idname, text="", icon="CANCEL")
    column = layout.column(align=True)
    if state.total:
        column.label(text=step_in_words(state.stage, state.step, state.total))
        if left := state.time_left():
            column.label(text=left[0].upper() + left[1:])
    if state.gaussians:
        column.label(text=f"{state.gaussians:,} Gaussians")
    if state.psnr:
        column.label(text=f"PSNR: {state.psnr:.1f} dB (higher is better)")
    if state.message:
        say(column, state.message, "INFO")
    if current.job is not None and current.job.hears_esc and not current.job.stopping:
        kept = "; work so far is kept" if state.title in RESUMED else ""
        column.label(text=f"Press Esc to stop{kept}", icon="BLANK1")


def draw_where(layout: bpy.types.UILayout) -> None:
    """Show the setting of where to train, on the preferences page and in the sidebar."""
    page = settings.page()
    if page is None:
        return
    layout.prop(page, "train_on")
    if settings.get().train_on == settings.CLUSTER:
        layout.prop(page, "cluster")
