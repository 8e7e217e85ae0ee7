"""What the user has deleted, hidden or moved of an object's Gaussians, in edit mode or by script.

An object's Gaussians are drawn from its file, which is fast. Once its points are no longer those
that were imported, they are written to a file of their own, in Blender's temporary folder, and
drawn from there. The .blend keeps the points, so nothing is lost with that folder. In edit mode
Blender gives no access to attributes, so edits are drawn when it is left. An imported object whose
own file is gone is drawn from its points, too.

What turns or scales all points at once, such as **Object ▸ Apply**, moves them but
not their shapes. So each point keeps where it was imported: the map of all points is found by it,
and drawn like a transformation of the object.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np

from ..blender import following, mesh_of, persistent
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..geometry.splat_cloud import write_splats
from ..properties import object_props
from ..shared import EngineError
from . import clouds
from .splat_attributes import (
    SHAPE,
    cloud_of,
    drawn,
    hidden,
    imported_frame,
    move_to_frame,
    targets_of,
    values,
)

MARK = "roigs_imported"
"""Custom property of a mesh: `state_of` of the points that were imported."""

FILE = "roigs_file"
"""Custom property of a mesh: `state_of` of the points in their file's frame, if `MARK` differs."""

PREFIX = "roigs-edited-"
"""Of the files with edits."""

_files: dict[int, str | None] = {}
"""Mesh, by its number in this session -> its file with edits.

Empty: no Gaussians are left. None: it has no edits, or they cannot be written.
"""

_applied: dict[int, Matrix] = {}
"""Mesh -> the map that all of its points went through; its file is as it was before."""

_written: dict[int, str] = {}
"""Mesh -> `state_of` of the points in its file with edits."""

_changed: set[int] = set()
"""Meshes that may have been edited since their file was written."""

_problems: dict[int, str] = {}
"""Mesh -> why its edits are not drawn, in one line."""

MIXED = (
    "'{}' joins Gaussians that are made for different renderers. All are drawn as for {}: the"
    " others look wrong. Undo, and do not join them"
)
_mixed: dict[int, str] = {}
"""Mesh that was joined of both kinds -> that in one line."""


def mark_imported(mesh: bpy.types.Mesh) -> None:
    """Remember the points as they are now: they are what the file holds."""
    mesh[MARK] = state_of(mesh)


def file_of(item: bpy.types.Object) -> str:
    """The PLY of what an object shows: its own, or one with its edits; empty if nothing is left."""
    own: str = object_props(item).ply
    mesh = item.data
    if not own or not isinstance(mesh, bpy.types.Mesh) or mesh.get(MARK) is None:
        return own
    uid = mesh.session_uid
    if (uid not in _files or uid in _changed) and not mesh.is_editmode:
        gone = object_props(item).level == "IMPORTED" and not os.path.isfile(own)
        _look(mesh, uid, own_file=not gone)
    edited = _files.get(uid)
    return own if edited is None else edited


def frame_of(item: bpy.types.Object) -> Matrix:
    """(4, 4) from the frame of `file_of` to the object's."""
    mesh = item.data
    if not isinstance(mesh, bpy.types.Mesh):
        return np.eye(4)
    applied = _applied.get(mesh.session_uid)
    return imported_frame(mesh) if applied is None else applied


def whole_frame(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the frame of a mesh's file to its own, with what all points went through."""
    found = cloud_of(mesh) if _differs(mesh) else None
    return imported_frame(mesh) if found is None else found[1]


def place(mesh: bpy.types.Mesh, frame: Matrix) -> None:
    """Move a new mesh from its file's frame to another one: that is no edit."""
    mesh[FILE] = mesh[MARK]
    move_to_frame(mesh, frame)
    mark_imported(mesh)


def problem(items: Iterable[bpy.types.Object]) -> str:
    """Why edits of these objects are not drawn, in one line; empty if they are."""
    data = (item.data for item in items)
    return next((_problems[d.session_uid] for d in data if d and d.session_uid in _problems), "")


def remark(items: Iterable[bpy.types.Object]) -> str:
    """What does not look right of these objects after an edit, in one line; or nothing."""
    data = (item.data for item in items)
    return next((_mixed[d.session_uid] for d in data if d and d.session_uid in _mixed), "")


def _look(mesh: bpy.types.Mesh, uid: int, *, own_file: bool) -> None:
    """Bring the file with a mesh's edits up to date; without a file of its own, it needs one."""
    _changed.discard(uid)
    _problems.pop(uid, None)
    _mixed.pop(uid, None)
    try:
        _files[uid] = _file(mesh, uid, own_file=own_file)
    except AddonError as error:
        _problems[uid], _files[uid] = str(error), None
    found = targets_of(mesh, drawn(mesh)) if _files[uid] else []
    if len(found) > 1:
        _mixed[uid] = MIXED.format(mesh.name, found[0].title)


def is_edited(item: bpy.types.Object) -> bool:
    """Whether an object's points are no longer those that were imported."""
    mesh = item.data
    return isinstance(mesh, bpy.types.Mesh) and _differs(mesh)


def _differs(mesh: bpy.types.Mesh) -> bool:
    return mesh.get(MARK) not in (None, state_of(mesh))


def put_aside(item: bpy.types.Object) -> None:
    """Keep an object's points, if they were edited, while it shows those of another result."""
    if is_edited(item):
        object_props(item).aside.add().mesh = mesh_of(item)


def take_back(item: bpy.types.Object) -> None:
    """Give an object its edits of the result that it shows now, if any were put aside."""
    fresh, edited = item.data, _take_aside(item)
    if edited is not None:
        item.data = edited
        if fresh is not None and not fresh.users:
            bpy.data.batch_remove([fresh])


def drop_aside(item: bpy.types.Object) -> None:
    """Forget the edits of the result that an object shows now."""
    edited = _take_aside(item)
    if edited is not None and not edited.users:
        bpy.data.batch_remove([edited])


def _take_aside(item: bpy.types.Object) -> bpy.types.Mesh | None:
    """Remove what was put aside of the result that an object shows now, and return it.

    Edits belong to the points that they were made of, wherever their file is by now.
    """
    aside, mark = object_props(item).aside, _points_of(item.data)
    found = None
    for at in reversed(range(len(aside))):
        mesh = aside[at].mesh
        if mesh is None or _points_of(mesh) == mark:
            found = mesh or found
            aside.remove(at)
    return found


def _points_of(data: bpy.types.ID | None) -> object:
    """What tells the points of one file from those of another, wherever they were placed."""
    return data.get(FILE, data.get(MARK)) if data is not None else None


def look_again(item: bpy.types.Object) -> None:
    """Notice edits by scripts, of which Blender may not have told."""
    if item.data is not None:
        _changed.add(item.data.session_uid)


def _file(mesh: bpy.types.Mesh, uid: int, *, own_file: bool) -> str | None:
    """The file with a mesh's edits, written if it is not there, as `_files` has it.

    Raises:
        AddonError: it cannot be written, or the points are no Gaussians any more.
    """
    state = state_of(mesh)
    # The same name for all edits of a mesh: while it is read again, its last state is drawn.
    path = Path(bpy.app.tempdir) / f"{PREFIX}{uid}.ply"
    if state == mesh[MARK] and own_file:
        _written.pop(uid, None)
        _applied.pop(uid, None)
        with suppress(OSError):
            path.unlink(missing_ok=True)
        return None
    if state == _written.get(uid) and path.is_file():
        return str(path)
    _applied.pop(uid, None)
    found = cloud_of(mesh)
    if found is None:
        raise AddonError(
            f"'{mesh.name}' is drawn as it was imported: its points lack attributes of Gaussians."
        )
    cloud, _applied[uid] = found
    if not len(cloud):
        return ""
    try:
        write_splats(path, cloud)
    except (EngineError, OSError) as error:
        raise AddonError(f"Edits of '{mesh.name}' are not drawn: {error}") from error
    _written[uid] = state
    return str(path)


def state_of(mesh: bpy.types.Mesh) -> str:
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
    _forget()
    for item in bpy.data.objects:
        if item.mode != "OBJECT":  # saved so; it gets into that mode only after this
            file_of(item)


def _forget() -> None:
    for known in (_files, _written, _changed, _problems, _mixed, _applied):
        known.clear()


_follow, _leave = following(
    ("depsgraph_update_post", _on_change),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("load_post", _after_load),
)


def register() -> None:
    """Follow changes."""
    _follow()


def unregister() -> None:
    """Follow none."""
    _leave()
    _forget()
