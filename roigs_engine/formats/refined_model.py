"""Where the model with refined cameras of a COLMAP project is."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from .projects import SPARSE, project_folder

FIRST, NAME = "0", "refined"
CAMERAS = "cameras.bin"
PARTS = (CAMERAS, "images.bin", "points3D.bin")
"""Of a refined model, which is always binary."""
IMAGES = ("images.bin", "images.txt")
"""Every model has one of these."""


def refined_folder(colmap: Path) -> Path:
    """The folder of the refined model, for the folder of a project or of one of its models.

    A project's folder of photos stands for the project. In a project with `sparse` it is
    `sparse/refined`; for a model `sparse/1`, `sparse/refined-1`. No two models share one, and the
    engine finds the project's photos from there.
    """
    colmap = project_folder(colmap)
    inside = colmap / SPARSE
    if os.path.isdir(inside):
        return inside / NAME
    if colmap.parent.name != SPARSE:
        return colmap / NAME
    if is_refined_name(colmap):
        return colmap
    return colmap.with_name(NAME if colmap.name == FIRST else f"{NAME}-{colmap.name}")


def is_refined_name(folder: Path) -> bool:
    """Whether the folder is called like that of a refined model."""
    return folder.name == NAME or folder.name.startswith(f"{NAME}-")


def is_complete(folder: Path) -> bool:
    """Whether a folder holds a refined model."""
    return all(os.path.isfile(folder / name) for name in PARTS)


def is_outdated(folder: Path) -> bool:
    """Whether a model that the refined one may have been made from is newer."""
    parent = folder.parent
    models = [parent, *(child for child in parent.glob("*") if child.name.isdecimal())]
    return _newest(models) > _newest([folder])


def _newest(models: Iterable[Path]) -> float:
    files = (model / name for model in models for name in IMAGES)
    return max((file.stat().st_mtime for file in files if os.path.isfile(file)), default=0.0)
