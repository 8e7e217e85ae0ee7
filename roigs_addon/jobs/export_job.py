"""Exporting: the engine writes what a render shows as one file for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..blender import leave_edit_mode
from ..engine.writing import writing
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..scene import edits
from ..scene.frame_request import models_of, shown
from ..shared import files
from .spec import EXPORTING, JobSpec

if TYPE_CHECKING:
    from collections.abc import Sequence

NAME = "roigs-export"
"""Of the list of models and of the log, in Blender's temporary folder."""

UP = {
    "-Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
"""The axis that points up in the file -> rotation from Blender's world."""

NOTHING = "There is nothing to export: {}."


def spec(
    context: bpy.types.Context, path: Path, *, up: str, sh_degree: int, selected: bool
) -> JobSpec:
    """The job that writes the Gaussians, edited, moved and turned as they are now.

    Args:
        context: its scene, and which objects are selected.
        path: of the file.
        up: a key of `UP`.
        sh_degree: highest degree of view-dependent colour.
        selected: only selected objects.

    Raises:
        AddonError: there is nothing to export, an edit cannot be written, or the folder is missing.
    """
    scene = context.scene
    assert scene is not None
    items = shown(scene)
    if selected:
        items = [item for item in items if item in context.selected_objects]
    leave_edit_mode(items)  # Blender keeps what was done in it to itself until then
    models = models_of(items, context.evaluated_depsgraph_get())
    if problem := edits.problem(items):
        raise AddonError(problem)
    if not models:
        why = "no Gaussians are selected" if selected else "renders show no Gaussians"
        raise AddonError(NOTHING.format(why))
    if not path.parent.is_dir():
        raise AddonError(f"{path.parent} is not a folder.")
    listed = Path(bpy.app.tempdir) / f"{NAME}.json"
    with writing(listed.parent, "temporary folder in Blender's preferences"):
        files.write_json(listed, {"models": _turned(models, UP[up])}, durable=False)
    return JobSpec(
        title=EXPORTING,
        arguments=["convert", str(listed), str(path), "--sh-degree", str(sh_degree)],
        log=listed.with_suffix(".log"),
        done_text=f"Exported {path.name}",
    )


def _turned(
    models: list[dict[str, object]], rotation: Sequence[Sequence[float]]
) -> list[dict[str, object]]:
    turn: Matrix = np.eye(4)
    turn[:3, :3] = rotation
    return [model | {"matrix": (turn @ np.array(model["matrix"])).tolist()} for model in models]
