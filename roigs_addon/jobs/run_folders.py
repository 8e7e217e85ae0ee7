"""Finds each scene's run folder, and keeps the scene's paths through saving, loading and undo.

The first job that writes into the folder stores its path in the scene's settings. While a file is
open the path is absolute, so it stays right after Save As and undo. In the saved file it is
relative if the folder is below the file, so that both can be moved together. Any path that the user
typed as relative stays relative, and leads to the same place after Save As.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

from .. import settings
from ..blender import following, full_path, is_local, persistent, stored
from ..engine.writing import writing
from ..errors import AddonError
from ..properties import object_props, scene_props
from ..scene import lookup
from ..shared import run_files

_settled: dict[int, str] = {}
"""Scene (`session_uid`) -> the path that `settle` stored, because an undo would remove it."""

PATHS = ("photos", "project", "masks", "colmap", "images", "run_dir")
"""Properties of a scene. Other `photos` clear the two after them."""

_saving: dict[int, dict[str, tuple[Path, bool]]] = {}
"""Scene -> its changed paths in full and whether they were relative, while the file is saved."""


def run_folder(scene: bpy.types.Scene) -> Path:
    """Return the scene's run folder, or the one that it would get."""
    chosen: str = scene_props(scene).run_dir
    return full_path(chosen) if chosen else _proposed(scene)


def settle(scene: bpy.types.Scene) -> Path:
    """Create the scene's run folder, and store its path in the scene.

    Before a file is first saved, its run folder is in the user's folder. If nothing was trained
    there, its selections, masks and imported Gaussians are copied to a folder beside the saved
    file.

    Raises:
        AddonError: another scene uses it too, it cannot be created, or it is not a full path.
    """
    folder = run_folder(scene)
    for other in bpy.data.scenes:
        if other != scene and scene_props(other).run_dir and run_folder(other) == folder:
            raise AddonError(
                f"Scene '{other.name}' also uses the run folder {folder}. Change one of them."
            )
    if scene_props(scene).run_dir:
        stored(scene_props(scene).run_dir)
    before, moves = folder, _is_left_behind(folder)
    if moves:
        folder = _proposed(scene)
    with writing(folder, "Run Folder"):
        if moves and not folder.exists():
            _copy(scene, before, folder)
        folder.mkdir(parents=True, exist_ok=True)
    if moves or not scene_props(scene).run_dir:
        scene_props(scene).run_dir = _settled[scene.session_uid] = str(folder)
    return folder


def _is_left_behind(folder: Path) -> bool:
    """Whether a folder was made before the file was first saved, and nothing was trained in it."""
    kept = bpy.data.filepath and folder.parent == settings.unsaved_folder()
    trained = run_files.MANIFEST, run_files.STAGES, run_files.LOCK
    return bool(kept) and not any((folder / name).exists() for name in trained)


def _copy(scene: bpy.types.Scene, before: Path, folder: Path) -> None:
    """Copy a folder, and make objects refer to the copy. Another file may use the original."""
    shutil.copytree(before, folder, symlinks=True)
    for item in lookup.splats(scene):
        own = Path(object_props(item).ply)
        if own.is_relative_to(before) and is_local(item):
            object_props(item).ply = str(folder / own.relative_to(before))


def finder(scene: bpy.types.Scene) -> Callable[[], bpy.types.Scene | None]:
    """Return a function that finds the scene when a job ends.

    Undo and loading a file invalidate Python's reference to it. A file that was loaded meanwhile
    contains the scene if it trains the same model in the same folder.
    """
    uid, colmap = scene.session_uid, scene_props(scene).colmap
    folder = run_folder(scene) if scene_props(scene).run_dir or bpy.data.filepath else None

    def find() -> bpy.types.Scene | None:
        for now in bpy.data.scenes:  # undo keeps the uid; no other file has it
            if now.session_uid == uid:
                return now
        same_model = (s for s in bpy.data.scenes if scene_props(s).colmap == colmap)
        return next((s for s in same_model if run_folder(s) == folder), None)

    return find


def _proposed(scene: bpy.types.Scene) -> Path:
    """Return a folder beside the .blend; without a file, a new one in the user's folder."""
    taken = {run_folder(other) for other in bpy.data.scenes if scene_props(other).run_dir}
    if bpy.data.filepath:
        # A folder there is this scene's: the file was not saved after its training.
        return next(folder for folder in _beside_blend(scene) if folder not in taken)
    name: str = scene_props(scene).colmap or scene.name
    # Many projects' folders have the same name.
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    folders = _numbered(settings.unsaved_folder() / f"{_plain(name)}-{mark}")
    return next(f for f in folders if f not in taken and not os.path.lexists(f))


def _beside_blend(scene: bpy.types.Scene) -> Iterator[Path]:
    """Yield folders named after the file, and also the scene if another scene comes first."""
    blend = Path(bpy.data.filepath)
    without = (s for s in bpy.data.scenes if s == scene or not scene_props(s).run_dir)
    if next(s for s in without if scene_props(s).colmap or s == scene) == scene:
        yield blend.with_name(f"{blend.stem}_roigs")
    yield from _numbered(blend.with_name(f"{blend.stem}_{_plain(scene.name)}_roigs"))


def _numbered(folder: Path) -> Iterator[Path]:
    yield folder
    yield from (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))


def _plain(text: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in Path(text).name) or "scene"


@persistent
def _before_save(path: str, *_: object) -> None:
    """Adapt the paths to the file's new place; Blender does not adapt those of add-ons."""
    parent = Path(path).parent
    moves = bpy.data.filepath and Path(bpy.data.filepath).parent != parent
    for scene in _own(path):
        paths = {name: str(getattr(scene_props(scene), name)) for name in PATHS}
        known = {n: (full_path(p), True) for n, p in paths.items() if moves and p.startswith("//")}
        folder = paths["run_dir"]
        if folder and not folder.startswith("//") and _moves_with(parent, full_path(folder)):
            known["run_dir"] = full_path(folder), False
        _saving[scene.session_uid] = known
        _set(scene, {name: _relative(full, parent) for name, (full, _) in known.items()})


@persistent
def _after_save(*_: object) -> None:
    """Restore paths for the open file, which is still the old one if a copy was saved."""
    parent = Path(bpy.data.filepath).parent
    for scene in bpy.data.scenes:
        known = _saving.pop(scene.session_uid, {})
        paths = {n: _relative(p, parent) if was else str(p) for n, (p, was) in known.items()}
        _set(scene, paths)


@persistent
def _after_load(*_: object) -> None:
    """Make the paths of folders below the file absolute."""
    _settled.clear()
    parent = Path(bpy.data.filepath).parent
    for scene in _own(bpy.data.filepath):
        folder = run_folder(scene)
        if scene_props(scene).run_dir and folder.is_relative_to(parent):
            scene_props(scene).run_dir = str(folder)


@persistent
def _after_undo(*_: object) -> None:
    for scene in bpy.data.scenes:
        chosen = scene_props(scene).run_dir
        if scene.session_uid in _settled and (not chosen or _is_left_behind(full_path(chosen))):
            scene_props(scene).run_dir = _settled[scene.session_uid]


def _own(blend: str) -> list[bpy.types.Scene]:
    """Return the file's own scenes; none without a file."""
    return [scene for scene in bpy.data.scenes if blend and scene.library is None]


def _set(scene: bpy.types.Scene, paths: dict[str, str]) -> None:
    """Change some of a scene's paths; the others stay."""
    props = scene_props(scene)
    wanted = {name: getattr(props, name) for name in PATHS} | paths
    for name, path in wanted.items():
        if getattr(props, name) != path:
            setattr(props, name, path)


def _moves_with(parent: Path, folder: Path) -> bool:
    """Whether a folder is below the .blend's one, and not in the user's folder."""
    kept = settings.unsaved_folder()
    return folder.is_relative_to(parent) and not folder.is_relative_to(kept)


def _relative(folder: Path, parent: Path) -> str:
    try:
        return "//" + os.path.relpath(folder, parent).replace(os.sep, "/")
    except ValueError:  # on another drive
        return str(folder)


_follow, _leave = following(
    ("save_pre", _before_save),
    ("save_post", _after_save),
    ("save_post_fail", _after_save),
    ("load_post", _after_load),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
)


def register() -> None:
    """Add the handlers."""
    _follow()


def unregister() -> None:
    """Remove the handlers."""
    _settled.clear()
    _leave()
