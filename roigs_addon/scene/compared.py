"""Shows another result in the same objects; places, visibility, view and edits stay."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..blender import leave_edit_mode
from ..properties import object_props
from . import compositor, edits, ownership, splats, visibility
from .renamed_boxes import renamed


def shown_result(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of the shown result, from its background's file; None if there is none."""
    shown = (object_props(item) for item in ownership.own_splats(scene))
    return next((Path(props.ply).parent for props in shown if props.level == "RESULT"), None)


def show_last(scene: bpy.types.Scene, folder: Path) -> None:
    """Show the result of a run folder, unless it is shown already.

    Raises:
        AddonError: a file is missing or damaged.
    """
    shown = shown_result(scene)
    if shown is None:
        splats.show_results(scene, folder)
    elif shown != folder:
        switch(scene, folder)


def switch(scene: bpy.types.Scene, folder: Path) -> None:
    """Show the result of a run folder, or an earlier one.

    Objects that this result lacks, such as edited copies, are parked: they are hidden until a
    result that has them is shown.

    Raises:
        AddonError: a file is missing or damaged.
    """
    leave_edit_mode(ownership.own_splats(scene))
    files = splats.result_files(folder)
    splats.take_names(scene, splats.result_files(shown_result(scene) or folder))
    fresh = splats.read_files(files)
    splats.rename_boxes(scene, renamed(scene, fresh))
    for item in ownership.own_splats(scene):
        edits.put_aside(item)
    for part, file in files.items():
        for item in splats.show(scene, part, file, fresh[part]):
            edits.take_back(item)
    for item in ownership.own_splats(scene):
        props = object_props(item)
        if props.ply == str(files.get((props.level, props.roi), "")):
            visibility.unpark(item)
        elif props.level != "PREVIEW":
            visibility.park(item)
    compositor.link(scene)
