"""Excluded photos in the panels: their number, and buttons to change them."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..facts import photo_names, weak_photos
from ..operators.photos import ExcludePhotos, IncludePhotos
from ..operators.scene import LookThrough
from ..scene import exclusions, lookup
from ..shared import projects as rule
from ..shared import text
from . import layout as show

MOST_WEAK = 4
"""Most weak photos shown."""
MOST_FAULTY = 8
"""Most photos with a fault shown."""


def counted(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show '3 photos excluded', with the button that includes them; nothing if there are none."""
    count = len(photo_names.excluded(scene))
    if not count:
        return
    row = layout.split(factor=0.62, align=True)
    row.label(text=f"{text.counted(count, 'photo')} excluded", icon="CANCEL")
    row.operator(IncludePhotos.bl_idname, text="Include All").every = True


def toggle(layout: bpy.types.UILayout, scene: bpy.types.Scene, photo: str) -> None:
    """Show the button that excludes a photo, or includes it again."""
    if exclusions.is_excluded(scene, photo):
        label = "Include Photo"
        layout.operator(IncludePhotos.bl_idname, text=label, icon="LOOP_BACK").photo = photo
    else:
        label = "Exclude Photo"
        layout.operator(ExcludePhotos.bl_idname, text=label, icon="CANCEL").photo = photo


def weak(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Show photos with few points for their cameras, each with a button that excludes it."""
    names = weak_photos.used(scene)
    if not names:
        return
    show.wrong(layout, f"Perhaps misplaced (fewer than {rule.FEWEST_OBSERVED} points):")
    column = layout.column(align=True)
    for name in names[:MOST_WEAK]:
        label = f"Exclude {photo_names.short_name(scene, name)}"
        column.operator(ExcludePhotos.bl_idname, text=label, icon="CANCEL").photo = name
    if len(names) > MOST_WEAK:
        show.say(column, f"{len(names) - MOST_WEAK} more", "BLANK1")


def faulty(
    layout: bpy.types.UILayout, scene: bpy.types.Scene, faults: Sequence[tuple[str, str, str]]
) -> None:
    """Show doubtful photos, each with buttons to look through it and to exclude it.

    Args:
        layout: to draw in.
        scene: of the photos.
        faults: name, reason in a word or two, reason with its figure for the tooltip.
    """
    left = [fault for fault in faults if not exclusions.is_excluded(scene, fault[0])]
    if not left:
        return
    show.wrong(layout, "Look at these photos, and exclude the bad ones:")
    column = layout.column(align=True)
    for photo, reason, figure in left[:MOST_FAULTY]:
        row = column.row(align=True)
        split = row.split(factor=0.45, align=True)
        split.label(text=photo_names.short_name(scene, photo), icon="BLANK1")
        split.label(text=reason)
        row.operator(LookThrough.bl_idname, text="", icon="HIDE_OFF").photo = photo
        button = row.operator(ExcludePhotos.bl_idname, text="", icon="CANCEL")
        button.photo, button.reason = photo, figure
    if len(left) > MOST_FAULTY:
        show.say(layout, f"{len(left) - MOST_FAULTY} more", "BLANK1")


def selected(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Show the buttons for the cameras selected in the 3D view; nothing if none is."""
    if not any(lookup.is_photo_camera(item) for item in context.selected_objects):
        return
    row = layout.split(factor=0.62, align=True)
    row.operator(ExcludePhotos.bl_idname, text="Exclude Selected")
    row.operator(IncludePhotos.bl_idname, text="Include")
