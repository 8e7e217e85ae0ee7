"""Making surfaces: the engine makes meshes of a result's boxes, which then are in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy

from ..engine import own_files, run_status
from ..errors import AddonError
from ..properties import scene_props
from ..scene import box_surfaces, compared, rois
from ..shared import text
from ..windows import redraw
from . import options_files, run_folders
from .spec import SURFACES, JobSpec

EDITED = "'{}' was edited since it was made. {}"
GLB = ".glb"


def trained_name(scene: bpy.types.Scene, roi: bpy.types.Object) -> str:
    """The name of a box in the run folder: it may have been renamed since its training."""
    status = run_status.read(run_folders.run_folder(scene))
    return rois.trained_names(scene, status.boxes or {}).get(roi.name, roi.name)


def spec(scene: bpy.types.Scene, boxes: Sequence[str], *, replace_edits: bool) -> JobSpec:
    """The job that makes the meshes of boxes of the last result, which is then shown.

    Args:
        scene: of the result.
        boxes: their names in the run folder; empty: all.
        replace_edits: also meshes that the user has edited.

    Raises:
        AddonError: the run folder cannot be written to, or a mesh was edited.
    """
    props = scene_props(scene)
    folder, find = run_folders.settle(scene), run_folders.finder(scene)
    if not replace_edits:
        _refuse_edited(scene, boxes, "To replace it, give replace_edits=True.")
    made: dict[str, Path] = {}

    def take(outputs: Mapping[str, str]) -> None:
        made.update({n: Path(path) for n, path in outputs.items() if path.endswith(GLB)})

    def show() -> str | None:
        now = find()
        if now is None:
            return None
        if not replace_edits:  # meanwhile
            _refuse_edited(now, list(made), "Click the button again to replace it.")
        compared.show_last(now, folder)
        for name, path in made.items():
            box_surfaces.show(now, name, path)
        redraw()
        return f"Made {text.counted(len(made), 'surface')}"

    only = [f"--only={name}" for name in boxes]
    closed = ["--watertight"] if props.watertight else []
    options = [*only, *closed, f"--faces={props.faces}", *options_files.machine_options()]
    return JobSpec(
        title=SURFACES,
        arguments=["surface", str(folder), *options],
        log=own_files.log_file(folder),
        folder=folder,
        then=take,
        on_done=show,
        done_text="The surface is made",
    )


def _refuse_edited(scene: bpy.types.Scene, boxes: Sequence[str], remedy: str) -> None:
    if names := box_surfaces.edited(scene, boxes):
        raise AddonError(EDITED.format(names[0], remedy))
