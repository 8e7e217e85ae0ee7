"""First folder of file browsers: the last used one, also in other files and after a restart."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import bpy

from .. import settings
from ..jobs.import_job import project_folder
from ..shared import EngineError, files

FILE = "folders.json"
IMPORT, PHOTOS, BOXES, BOXES_OF = "import", "photos", "boxes", "boxes of"
EXPORT, GAUSSIANS = "export", "gaussians"


def for_import(colmap: str) -> str:
    """Folder to choose a project's folder in; empty if Blender's own choice is as good.

    Args:
        colmap: the scene's COLMAP folder; empty before the first import.
    """
    here = str(project_folder(Path(colmap)).parent) if colmap else ""
    return _first(_last().get(IMPORT, ""), here, _beside_blend())


def for_boxes(colmap: str) -> str:
    """Folder to load boxes from: the project's, unless others were loaded for it."""
    last = _last()
    before = last.get(BOXES, "")
    project = str(project_folder(Path(colmap))) if colmap else ""
    same = last.get(BOXES_OF) == colmap
    return _first(before if same else "", project, before, _beside_blend())


def for_export(colmap: str) -> str:
    """Folder to export to: where the last export went, else beside the .blend or the project."""
    project = str(project_folder(Path(colmap)).parent) if colmap else ""
    return _first(_last().get(EXPORT, ""), _beside_blend(), project)


def for_gaussians() -> str:
    """Folder to import Gaussians from."""
    return _first(*(_last().get(key, "") for key in (GAUSSIANS, EXPORT)), _beside_blend())


def for_photos(photos: str) -> str:
    """Folder to choose photos in: the scene's own, else beside the last one."""
    return _first(photos, _last().get(PHOTOS, ""), _beside_blend())


def chosen_photos(folder: Path) -> None:
    """Remember where photos were chosen."""
    _remember({PHOTOS: str(folder.parent)})


def imported(folder: Path) -> None:
    """Remember where a project was chosen."""
    _remember({IMPORT: str(project_folder(folder).parent)})


def loaded_boxes(path: Path, colmap: str) -> None:
    """Remember where boxes were loaded from, and for which COLMAP folder."""
    _remember({BOXES: str(path.parent), BOXES_OF: colmap})


def exported(path: Path) -> None:
    """Remember where a file was exported to."""
    _remember({EXPORT: str(path.parent)})


def imported_gaussians(path: Path) -> None:
    """Remember where Gaussians were imported from."""
    _remember({GAUSSIANS: str(path.parent)})


def _first(*folders: str) -> str:
    """The first one that exists, as file browsers take it."""
    return next((os.path.join(f, "") for f in folders if f and os.path.isdir(f)), "")


def _beside_blend() -> str:
    return os.path.dirname(bpy.data.filepath)


def _last() -> dict[str, str]:
    try:
        record = files.read_json(settings.data_folder() / FILE)
    except EngineError:  # none yet, or damaged: only a convenience
        return {}
    return {str(k): str(v) for k, v in record.items()} if isinstance(record, dict) else {}


def _remember(entries: dict[str, str]) -> None:
    folder = settings.data_folder()
    with suppress(OSError, EngineError):
        folder.mkdir(parents=True, exist_ok=True)
        files.write_json(folder / FILE, _last() | entries)
