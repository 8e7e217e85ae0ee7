"""Code shared with the engine: formats and their errors. Numpy only, no bpy.

In a Blender extension, both packages are inside the extension's own package. In a checkout and its
tests, they are top-level packages. All other files of the add-on import from here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING or __package__ == "roigs_addon":
    from roigs_engine.errors import EngineError
    from roigs_engine.formats import (
        clean_up,
        confidence,
        drawable,
        events,
        files,
        foreground,
        frame_requests,
        gravity,
        levels,
        lock,
        mask_record,
        names,
        others,
        projects,
        rois,
        run_files,
        scene_transform,
        scratch,
        scribbles,
        splat_ply,
        stage_list,
        targets,
        text,
        transforms,
    )
    from roigs_engine.requests import choices, declare, values
    from roigs_engine.requests import projects as project_requests
    from roigs_engine.requests import runs as run_requests
else:
    from ..roigs_engine.errors import EngineError
    from ..roigs_engine.formats import (
        clean_up,
        confidence,
        drawable,
        events,
        files,
        foreground,
        frame_requests,
        gravity,
        levels,
        lock,
        mask_record,
        names,
        others,
        projects,
        rois,
        run_files,
        scene_transform,
        scratch,
        scribbles,
        splat_ply,
        stage_list,
        targets,
        text,
        transforms,
    )
    from ..roigs_engine.requests import choices, declare, values
    from ..roigs_engine.requests import projects as project_requests
    from ..roigs_engine.requests import runs as run_requests

__all__ = [
    "EngineError",
    "choices",
    "clean_up",
    "confidence",
    "declare",
    "drawable",
    "events",
    "files",
    "foreground",
    "frame_requests",
    "gravity",
    "levels",
    "lock",
    "mask_record",
    "names",
    "others",
    "project_requests",
    "projects",
    "rois",
    "run_files",
    "run_requests",
    "scene_transform",
    "scratch",
    "scribbles",
    "splat_ply",
    "stage_list",
    "targets",
    "text",
    "transforms",
    "values",
]
