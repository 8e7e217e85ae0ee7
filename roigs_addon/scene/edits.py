"""What the user has deleted, hidden or moved of an object's Gaussians, in edit mode or by script.

An object's Gaussians are drawn from its file, which is fast. Once its points are no longer those
that were imported, they are written to a file of their own, in Blender's temporary folder, and
drawn from there. The .blend keeps the points, so nothing is lost with that folder. In edit mode
Blender gives no access to attributes, so edits are drawn when it is left.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import bpy

from ..blender import persistent
from ..errors import AddonError
from ..geometry.splat_cloud import write_splats
from ..properties import object_props
from ..shared import EngineError
from . import clouds
from .splat_attributes import SHAPE, cloud_of, hidden, values

MARK = "roigs_imported"
"""Custom property of a mesh: `_state` of the points that were imported."""

ASIDE = "roigs_edits_of"
"""Custom property of a mesh that no object shows now: the file whose points it holds, edited."""

PREFIX = "roigs-edited-"
"""Of the files with edits."""

_files: dict[int, str] = {}
"""Mesh, by its number in this session -> its file with edits; empty: it has none."""

_written: dict[int, str] = {}
"""Mesh -> `_state` of the points in its file with edits."""

_changed: set[int] = set()
"""Meshes that may have been edited since their file was written."""

problem = ""
"""Why edits are not drawn, in one line; empty if they are."""


def mark_imported(mesh: bpy.types.Mesh) -> None:
    """Remember the points as they are now: they are what the file holds."""
    mesh[MARK] = _state(mesh)


def file_of(item: bpy.types.Object) -> str:
    """The PLY of what an object shows: its own, or one with its edits; empty if nothing is left."""
    global problem
    own: str = object_props(item).ply
    mesh = item.data
    if not own or not isinstance(mesh, bpy.types.Mesh) or mesh.get(MARK) is None:
        return own
    if not mesh.vertices:
        return ""
    uid = mesh.session_uid
    if (uid not in _files or uid in _changed) and not mesh.is_editmode:
        problem = ""
        _changed.discard(uid)
        try:
            _files[uid] = _file(mesh)
        except AddonError as error:
            problem, _files[uid] = str(error), ""
    return _files.get(uid) or own


def put_aside(item: bpy.types.Object) -> None:
    """Keep an object's points in the .blend, if they were edited, while it shows other ones."""
    mesh = item.data
    if isinstance(mesh, bpy.types.Mesh) and mesh.get(MARK) not in (None, _state(mesh)):
        mesh[ASIDE] = object_props(item).ply
        mesh.use_fake_user = True


def take_back(item: bpy.types.Object) -> None:
    """Give an object the edited points of its file that were put aside, if there are any."""
    for mesh in bpy.data.meshes:
        if mesh.get(ASIDE) == object_props(item).ply:
            fresh, item.data = item.data, mesh
            mesh.use_fake_user = False
            del mesh[ASIDE]
            if fresh is not None and not fresh.users:
                bpy.data.batch_remove([fresh])
            return


def follow(moved: Callable[[Path], Path | None]) -> None:
    """Points that were put aside follow their file; `moved` says where a missing one is now."""
    for mesh in bpy.data.meshes:
        file = mesh.get(ASIDE)
        if file and not os.path.isfile(file) and (now := moved(Path(file))) is not None:
            mesh[ASIDE] = str(now)


def look_again(item: bpy.types.Object) -> None:
    """Notice edits by scripts, of which Blender may not have told."""
    if item.data is not None:
        _changed.add(item.data.session_uid)


def _file(mesh: bpy.types.Mesh) -> str:
    """The file with a mesh's edits, written if it is not there; empty if it has none.

    Raises:
        AddonError: it cannot be written, or the points are no Gaussians any more.
    """
    uid, state = mesh.session_uid, _state(mesh)
    # The same name for all edits of a mesh: while it is read again, its last state is drawn.
    path = Path(bpy.app.tempdir) / f"{PREFIX}{uid}.ply"
    if state == mesh[MARK]:
        _written.pop(uid, None)
        with suppress(OSError):
            path.unlink(missing_ok=True)
        return ""
    if state == _written.get(uid) and path.is_file():
        return str(path)
    cloud = cloud_of(mesh)
    if cloud is None:
        raise AddonError(
            f"'{mesh.name}' is drawn as it was imported: its points lack attributes of Gaussians."
        )
    try:
        write_splats(path, cloud)
    except (EngineError, OSError) as error:
        raise AddonError(f"Edits of '{mesh.name}' are not drawn: {error}") from error
    _written[uid] = state
    return str(path)


def _state(mesh: bpy.types.Mesh) -> str:
    """Text that changes when points are deleted, hidden, moved or changed."""
    found = zlib.crc32(clouds.positions_of(mesh).data)
    found = zlib.crc32(hidden(mesh).data, found)
    for name in SHAPE:
        numbers = values(mesh, name)
        if numbers is not None:
            found = zlib.crc32(numbers.data, found)
    return f"{len(mesh.vertices)}-{found:08x}"


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """After every change."""
    for update in graph.updates if _files else ():
        changed = update.id if update.is_updated_geometry else None
        if isinstance(changed, bpy.types.Mesh) and changed.original is not None:
            _changed.add(changed.original.session_uid)


@persistent
def _after_undo(*_: object) -> None:
    _changed.update(_files)


@persistent
def _after_load(*_: object) -> None:
    _files.clear()
    _written.clear()
    _changed.clear()


HANDLERS = (
    ("depsgraph_update_post", _on_change),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("load_post", _after_load),
)


def register() -> None:
    """Follow changes."""
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister() -> None:
    """Follow none."""
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
    _after_load()
