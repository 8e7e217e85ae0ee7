"""Another result in the same objects, to compare: places, visibility, view and edits stay."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..blender import leave_edit_mode
from ..properties import object_props
from . import compositor, edits, lookup, splats

SEEN = ("view", "render")
"""Words for what a parked object was seen in."""


def shown_result(scene: bpy.types.Scene) -> Path | None:
    """The folder of the result whose background the scene has; None if it has none."""
    files = (object_props(i).ply for i in lookup.splats(scene) if object_props(i).level == "RESULT")
    return next((Path(file).parent for file in files), None)


def switch(scene: bpy.types.Scene, folder: Path) -> None:
    """Show the result of a run folder, or an archived one.

    What it does not have, such as edited copies, is parked: hidden until a result is shown that
    has it.

    Raises:
        AddonError: a file is missing or damaged.
    """
    leave_edit_mode(lookup.splats(scene))
    files = splats.result_files(folder)
    splats.take_names(scene, splats.result_files(shown_result(scene) or folder))
    fresh = splats.read_files(files)
    for item in lookup.splats(scene):
        edits.put_aside(item)
    for part, file in files.items():
        for item in splats.show(scene, part, file, fresh[part]):
            edits.take_back(item)
    for item in lookup.splats(scene):
        props = object_props(item)
        if props.ply == str(files.get((props.level, props.roi), "")):
            _unpark(scene, item)
        elif props.level not in ("PREVIEW", "IMPORTED"):
            _park(scene, item)
    compositor.link(scene)


def _park(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    props = object_props(item)
    if not props.parked:
        seen = (not item.hide_get(view_layer=scene.view_layers[0]), not item.hide_render)
        words = [word for word, is_seen in zip(SEEN, seen, strict=True) if is_seen]
        props.parked = " ".join(("parked", *words))
    splats.hide(scene, item, True)
    item.hide_render = True


def _unpark(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    props = object_props(item)
    if props.parked:
        seen = props.parked.split()
        splats.hide(scene, item, "view" not in seen)
        item.hide_render = "render" not in seen
        props.parked = ""
