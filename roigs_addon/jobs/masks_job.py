"""Making masks: the engine makes the masks of one box from strokes on photos."""

from __future__ import annotations

import os
import re

import bpy

from .. import settings
from ..engine import own_files
from ..engine.writing import writing
from ..errors import AddonError
from ..properties import object_props, scene_props
from ..scene import exclusions, lookup, masks, rois, scribbles
from ..shared import files, run_files
from . import options_files, run_folders
from .last_said import last_said
from .spec import MASKING, JobSpec

MADE = re.compile(r"(?:\S+ +)?Box '.+': (\d+ of \d+ masks?) written to .+\.")
"""Line of the engine with the number of masks, after the log's time of day."""
DRAW_FIRST = "Draw strokes on a photo first: on the object, and around it."


def spec(scene: bpy.types.Scene, roi: bpy.types.Object, *, anew: bool = False) -> JobSpec:
    """Return the job that makes a box's masks: those with changed strokes, or all if `anew`.

    Raises:
        AddonError: there is no model, there are no strokes, or files cannot be written.
    """
    colmap = options_files.colmap_folder(scene)
    if not scribbles.photos(roi):
        raise AddonError(DRAW_FIRST)
    folder = options_files.own_folder(scene)
    run = run_folders.run_folder(scene)
    out = masks.folder(scene, run)
    result = run / run_files.RESULT
    boxes, roi_name = lookup.rois(scene), roi.name
    with writing(folder, "Run Folder"):
        drawn, options = folder / own_files.SCRIBBLES, folder / own_files.MASKS_OPTIONS
        files.write_json(drawn, scribbles.document(roi))
        values = {
            "scene": str(colmap),
            "images": bpy.path.abspath(scene_props(scene).images) or None,
            "rois": str(rois.write(folder, boxes, scene)),
            "only": [roi.name],
            "scribbles": str(drawn),
            "model": str(result) if os.path.isfile(result) else None,
            "photo": _photos(scene, roi) or None,
            "threads": settings.get().threads or None,
            "device": settings.get().device,
            "anew": anew or None,
        }
        given = {key: value for key, value in values.items() if value is not None}
        files.write_json(options, given)
    log, place = own_files.log_file(run), masks.of_box(out, roi)

    def done() -> str:
        count = last_said(log, MADE)
        return f"{roi_name}: {count} written to {place}." if count else ""

    return JobSpec(
        title=MASKING,
        arguments=["masks", str(options), "--out", str(out)],
        log=log,
        on_done=done,
        changes=False,
        done_text=f"Masks of {roi_name} are in {place}.",
    )


def _photos(scene: bpy.types.Scene, roi: bpy.types.Object) -> list[str]:
    """Return the box's photos without excluded ones; if empty, the engine selects photos."""
    unused, there = set(exclusions.excluded(scene)), lookup.cameras(scene)
    names = [item.name for item in object_props(roi).selection]
    return [name for name in names if name not in unused and name in there]
