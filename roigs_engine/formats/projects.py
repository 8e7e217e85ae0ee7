"""Layout of a COLMAP project: its models, the refined one, its photos; weakly observed photos."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

PHOTO_FOLDERS = ("images", "images_2", "images_4", "images_8")  # the first that fits is used
VIDEOS = {  # extensions of videos; their frames become photos
    *(".mp4", ".m4v", ".mov", ".3gp", ".mkv", ".webm", ".avi"),
    *(".ts", ".mts", ".m2ts", ".m2t", ".mpg", ".mpeg"),
}
SPARSE = "sparse"
INNER = ("", "colmap", "undistorted", "dense/0", "dense", "distorted")
"""Folders in which a project may have its model; nerfstudio uses `colmap`, 3DGS `distorted`."""
RECONSTRUCTION = "reconstruction"  # folder of `reconstruct`'s own files
SUFFIXES = (".bin", ".txt")
FIRST_MODEL, REFINED = "0", "refined"
CAMERAS_FILE = "cameras.bin"
REFINED_FILES = (CAMERAS_FILE, "images.bin", "points3D.bin")  # a refined model is always binary
IMAGES_FILES = ("images.bin", "images.txt")  # every model has one of these
FEWEST_OBSERVED = 30
"""COLMAP registers a photo only with at least this many points. A photo has fewer if some were
rejected later, or if it was registered with lower limits."""


def model_suffix(folder: Path) -> str | None:
    """The suffix of the folder's cameras and images files, `.bin` or `.txt`; None: no model."""
    for suffix in SUFFIXES:
        if all(os.path.isfile(folder / (stem + suffix)) for stem in ("cameras", "images")):
            return suffix
    return None


def model_folders(project: Path) -> list[Path]:
    """The folders with a model: `sparse`, the project itself, and their numbered subfolders.

    If there is none, the same places are searched in each of the folders `INNER`, up to the first
    with a model.
    """
    for root in map(project.joinpath, INNER):
        places: list[Path] = []
        for parent in (root / SPARSE, root):
            numbered = [child for child in _children(parent) if child.name.isdecimal()]
            places += [*sorted(numbered, key=lambda child: int(child.name)), parent]
        found = [folder for folder in places if model_suffix(folder)]
        if found:
            return found
    return []


def folders_above(model: Path) -> list[Path]:
    """The model's folder and its parents, up to the project's.

    The project's folder contains `sparse` (at most two levels up). If that folder is one of
    `INNER`, the project's folder is the one that contains it.
    """
    roots = [model.absolute()]
    for folder in model.absolute().parents[:2]:
        roots.append(folder)
        if roots[-2].name == SPARSE:
            break
    project = roots[-1]
    for inner in filter(None, INNER):
        parts = Path(inner).parts
        if project.parts[-len(parts) :] == parts:
            return [*roots, *project.parents[: len(parts)]]
    return roots


def project_folder(folder: Path) -> Path:
    """The project of a folder: a folder of photos without a model stands for the one above."""
    if folder.name in PHOTO_FOLDERS and not model_folders(folder) and model_folders(folder.parent):
        return folder.parent
    return folder


def top_folder(folder: Path) -> Path:
    """The folder of a project; `folder` may also be its `sparse`, `sparse/0` or `images`."""
    while folder.parent.name and (SPARSE in (folder.name, folder.parent.name)):
        folder = folder.parent
    photos = folder.name.startswith(PHOTO_FOLDERS[0]) and os.path.isdir(folder.parent / SPARSE)
    return folder.parent if photos else folder


def refined_folder(colmap: Path) -> Path:
    """The folder of the refined model of a project or of one of its models.

    A project's folder of photos stands for the project. A project with `sparse` has it at
    `sparse/refined`, and a model `sparse/1` at `sparse/refined-1`. No two models share a folder,
    and the engine finds the project's photos from there.
    """
    colmap = project_folder(colmap)
    for inside in (colmap / inner / SPARSE for inner in INNER):
        if os.path.isdir(inside):
            return inside / REFINED
    if colmap.parent.name != SPARSE:
        return colmap / REFINED
    if is_refined_name(colmap):
        return colmap
    return colmap.with_name(REFINED if colmap.name == FIRST_MODEL else f"{REFINED}-{colmap.name}")


def is_refined_name(folder: Path) -> bool:
    """Whether the folder has the name of a refined model's folder."""
    return folder.name == REFINED or folder.name.startswith(f"{REFINED}-")


def is_refined_model(folder: Path) -> bool:
    """Whether a folder holds a refined model."""
    return all(os.path.isfile(folder / name) for name in REFINED_FILES)


def is_outdated(folder: Path) -> bool:
    """Whether a possible source of the refined model is newer than it."""
    parent = folder.parent
    models = [parent, *(child for child in parent.glob("*") if child.name.isdecimal())]
    return _newest(models) > _newest([folder])


def _newest(models: Iterable[Path]) -> float:
    files = (model / name for model in models for name in IMAGES_FILES)
    return max((file.stat().st_mtime for file in files if os.path.isfile(file)), default=0.0)


def weakly_observed(points: Mapping[str, int]) -> list[str]:
    """The photos that observe too few of their points (photo -> count), the fewest first."""
    found = sorted((count, name) for name, count in points.items() if count < FEWEST_OBSERVED)
    return [name for _, name in found]


def is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEOS and not os.path.isdir(path)


def _children(folder: Path) -> list[Path]:
    try:
        return [child for child in folder.iterdir() if os.path.isdir(child)]
    except OSError:
        return []
