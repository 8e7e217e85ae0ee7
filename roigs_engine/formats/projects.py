"""What is where in a COLMAP project: its models, and its folders of photos."""

from __future__ import annotations

import os
from pathlib import Path

PHOTO_FOLDERS = ("images", "images_2", "images_4", "images_8")
"""Names of a project's folders of photos; the first one that fits is used."""
VIDEOS = {".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v"}
"""Suffixes of videos that become photos."""
SPARSE = "sparse"
RECONSTRUCTION = "reconstruction"
"""What `reconstruct` keeps for itself."""
SUFFIXES = (".bin", ".txt")


def model_suffix(folder: Path) -> str | None:
    """The suffix of the folder's cameras and images files, `.bin` or `.txt`; None: no model."""
    for suffix in SUFFIXES:
        if all(os.path.isfile(folder / (stem + suffix)) for stem in ("cameras", "images")):
            return suffix
    return None


def model_folders(project: Path) -> list[Path]:
    """The folders with a model: `sparse`, the project itself, and their numbered subfolders."""
    places: list[Path] = []
    for parent in (project / SPARSE, project):
        numbered = [child for child in _children(parent) if child.name.isdecimal()]
        places += [*sorted(numbered, key=lambda child: int(child.name)), parent]
    return [folder for folder in places if model_suffix(folder)]


def project_folder(folder: Path) -> Path:
    """The project that a folder stands for: its folder of photos does, if it holds no model."""
    if folder.name in PHOTO_FOLDERS and not model_folders(folder) and model_folders(folder.parent):
        return folder.parent
    return folder


def top_folder(folder: Path) -> Path:
    """The folder of a project, of which `sparse`, `sparse/0` or `images` may be given."""
    while folder.parent.name and (SPARSE in (folder.name, folder.parent.name)):
        folder = folder.parent
    photos = folder.name.startswith(PHOTO_FOLDERS[0]) and os.path.isdir(folder.parent / SPARSE)
    return folder.parent if photos else folder


def _children(folder: Path) -> list[Path]:
    try:
        return [child for child in folder.iterdir() if os.path.isdir(child)]
    except OSError:
        return []
