"""Where each scene's training lives, whatever becomes of the .blend.

The first job that writes there puts the folder into the scene's settings. In the session it is
absolute, which a Save As and an undo leave right. In a file above it it is relative, so that both
can be moved together; so is one that was typed relative, wherever it lies.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from . import preferences
from .errors import AddonError, writing

_settled: dict[int, str] = {}
"""Scene -> what `settle` wrote there, which an undo would take back."""

_saving: dict[int, tuple[Path, bool]] = {}
"""Scene -> its run folder, and whether it was relative, while the file is written."""


def run_folder(scene: bpy.types.Scene) -> Path:
    """Where this scene's training lives, or would live."""
    chosen = scene.roigs.run_dir
    return Path(os.path.normpath(bpy.path.abspath(chosen))) if chosen else _proposed(scene)


def settle(scene: bpy.types.Scene) -> Path:
    """Make the scene's run folder, and keep it as its own.

    Raises:
        AddonError: it is another scene's, too, or cannot be made.
    """
    folder = run_folder(scene)
    for other in bpy.data.scenes:
        if other != scene and other.roigs.run_dir and run_folder(other) == folder:
            raise AddonError(
                f"Scene «{other.name}» has the run folder {folder}, too. Empty or change one's."
            )
    with writing(folder, "Run Folder"):
        folder.mkdir(parents=True, exist_ok=True)
    if not scene.roigs.run_dir:
        scene.roigs.run_dir = _settled[scene.session_uid] = str(folder)
    return folder


def finder(scene: bpy.types.Scene) -> Callable[[], bpy.types.Scene | None]:
    """Finds the scene when a job ends: undo and loading a file make Python's reference invalid.

    A file that was loaded meanwhile has it when it trains the same model in the same folder.
    """
    uid, colmap = scene.session_uid, scene.roigs.colmap
    folder = run_folder(scene) if scene.roigs.run_dir or bpy.data.filepath else None

    def find() -> bpy.types.Scene | None:
        for now in bpy.data.scenes:  # undo keeps the number, another file never has it
            if now.session_uid == uid:
                return now
        same = (s for s in bpy.data.scenes if s.roigs.colmap == colmap and run_folder(s) == folder)
        return next(same, None)

    return find


def _proposed(scene: bpy.types.Scene) -> Path:
    """Beside the .blend, or in the user's folder where no other run is."""
    taken = {run_folder(other) for other in bpy.data.scenes if other.roigs.run_dir}
    if bpy.data.filepath:
        # What is there is this scene's: the file was not saved after its training.
        return next(folder for folder in _beside_blend(scene) if folder not in taken)
    name = scene.roigs.colmap or scene.name
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]  # many projects' folders are called alike
    folders = _numbered(preferences.unsaved_folder() / f"{_plain(name)}-{mark}")
    return next(f for f in folders if f not in taken and not os.path.lexists(f))


def _beside_blend(scene: bpy.types.Scene) -> Iterator[Path]:
    """The file's name for its first scene that has no folder, and the scene's name with it."""
    blend = Path(bpy.data.filepath)
    waiting = [s for s in bpy.data.scenes if not s.roigs.run_dir and (s.roigs.colmap or s == scene)]
    if waiting[0] == scene:
        yield blend.with_name(f"{blend.stem}_roigs")
    yield from _numbered(blend.with_name(f"{blend.stem}_{_plain(scene.name)}_roigs"))


def _numbered(folder: Path) -> Iterator[Path]:
    yield folder
    yield from (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))


def _plain(text: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in Path(text).name) or "scene"


@persistent
def _before_save(path: str, *_: object) -> None:
    """Blender leaves an add-on's relative paths as they were, wherever it saves the file."""
    home = Path(path).parent
    for scene in _chosen(path):
        folder, relative = run_folder(scene), scene.roigs.run_dir.startswith("//")
        if bpy.data.filepath if relative else _moves_with(home, folder):
            _saving[scene.session_uid] = folder, relative
            scene.roigs.run_dir = _relative(folder, home)


@persistent
def _after_save(*_: object) -> None:
    """Back to what holds in the session, which has the old file still when a copy was saved."""
    home = Path(bpy.data.filepath).parent
    for scene in bpy.data.scenes:
        if scene.session_uid in _saving:
            folder, relative = _saving.pop(scene.session_uid)
            scene.roigs.run_dir = _relative(folder, home) if relative else str(folder)


@persistent
def _after_load(*_: object) -> None:
    """Folders below the file become absolute."""
    _settled.clear()
    home = Path(bpy.data.filepath).parent
    for scene in _chosen(bpy.data.filepath):
        folder = run_folder(scene)
        if folder.is_relative_to(home):
            scene.roigs.run_dir = str(folder)


@persistent
def _after_undo(*_: object) -> None:
    for scene in bpy.data.scenes:
        if not scene.roigs.run_dir and scene.session_uid in _settled:
            scene.roigs.run_dir = _settled[scene.session_uid]


def _chosen(blend: str) -> list[bpy.types.Scene]:
    """Scenes of the file itself that have a folder; none without a file."""
    return [s for s in bpy.data.scenes if blend and s.roigs.run_dir and s.library is None]


def _moves_with(home: Path, folder: Path) -> bool:
    """Below the file, but not in the user's folder, which may be below a file, too."""
    kept = preferences.unsaved_folder()
    return folder.is_relative_to(home) and not folder.is_relative_to(kept)


def _relative(folder: Path, home: Path) -> str:
    try:
        return "//" + os.path.relpath(folder, home).replace(os.sep, "/")
    except ValueError:  # on another drive
        return str(folder)


HANDLERS = (
    ("save_pre", _before_save),
    ("save_post", _after_save),
    ("save_post_fail", _after_save),
    ("load_post", _after_load),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
)


def register() -> None:
    """Follow the file."""
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister() -> None:
    """The reverse."""
    _settled.clear()
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
