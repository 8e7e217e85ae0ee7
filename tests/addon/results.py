"""Results of a run folder in Blender: archived, compared, edited."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

PARTS = ("result.ply", "background.ply", "rois", "coarse")

MORE = ("report.json", "settings.json")


def set_aside(folder: Path, name: str = "abcdef12") -> Path:
    """Move the results of a run folder aside, as a training with other settings does."""
    place = folder / "earlier" / name
    place.mkdir(parents=True)
    for part in (*PARTS, *MORE):
        if (folder / part).exists():
            (folder / part).rename(place / part)
    return place


def files(scene) -> set[Path]:
    return {Path(o.roigs.ply) for o in scene.objects if o.roigs.kind == "SPLATS"}


def choose(bpy: ModuleType, item, chosen) -> None:
    """Select points of an object in edit mode, where it stays."""
    bpy.ops.object.mode_set(mode="OBJECT")
    item.data.vertices.foreach_set("select", np.isin(np.arange(len(item.data.vertices)), chosen))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")


def cut(bpy: ModuleType, item, chosen) -> None:
    """Delete points of an object."""
    bpy.ops.roigs.select_gaussians(name=item.name)
    choose(bpy, item, chosen)
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
