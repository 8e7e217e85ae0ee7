"""The source of an object's Gaussians: its PLY, or its points after edits by the user.

Viewport, renders and export read files. The object's own file is fastest; it is used as long as it
is the imported one and the object's points are unchanged. Otherwise, the points are written to a
file in Blender's temporary folder. The .blend has all data: on another computer, it shows the same
picture without the run folder. In edit mode, Blender gives no access to attributes, so edits are
drawn after edit mode ends.

An operation that rotates or scales all points at once, such as **Object ▸ Apply**, moves them but
does not change their shapes. So each point keeps its imported position. From these, the map of all
points is computed, and drawn like a transformation of the object.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix as BlenderMatrix
from mathutils import Vector

from ..blender import following, mesh_of, persistent
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..geometry.splat_cloud import write_splats
from ..properties import object_props
from ..shared import EngineError, files
from . import clouds
from .splat_attributes import (
    FRAME,
    SHAPE,
    applied_map,
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

SOURCE = "roigs_ply"
"""Custom property of a mesh: `_fingerprint` of the file that it was imported from."""

HEAD = 2**20
"""Bytes at a file's start that its `_fingerprint` covers."""

PREFIX = "roigs-edited-"
"""Prefix of the names of files with points."""

_files: dict[tuple[int, bool], str | None] = {}
"""Mesh (`session_uid`), and whether its own file holds it -> the file of its points.

Empty if no Gaussians are left. None if its own file is drawn, or the points cannot be written.
"""

_applied: dict[int, Matrix] = {}
"""Edited mesh -> the common map of all its points; the written file does not include it."""

_maps: dict[int, Matrix] = {}
"""Mesh -> its `whole_frame`, until it changes."""

_written: dict[int, str] = {}
"""Mesh -> `state_of` of the points in their file."""

_fingerprints: dict[tuple[str, int, int], str] = {}
"""Path, modification time and size of an object's own file -> its `_fingerprint`."""

_changed: set[int] = set()
"""Meshes that may have been edited since their file was written."""

_problems: dict[int, str] = {}
"""Mesh -> why its edits are not drawn, in one line."""

MIXED = (
    "'{}' joins Gaussians made for different renderers. All are drawn as for {}, so the others "
    "look wrong. Undo the join"
)
_mixed: dict[int, str] = {}
"""Mesh joined from Gaussians for different renderers -> a warning in one line."""


def mark_imported(mesh: bpy.types.Mesh, path: Path | None = None) -> None:
    """Mark the points as they are now as unedited, as the file holds them.

    Args:
        mesh: of the points.
        path: of the file, if it was just read.
    """
    mesh[MARK] = state_of(mesh)
    if path is not None:
        mesh[SOURCE] = _fingerprint(str(path))


def file_of(item: bpy.types.Object) -> str:
    """Return the PLY that an object shows: its own, or its written points; empty without points."""
    own: str = object_props(item).ply
    mesh = item.data
    if not own or not isinstance(mesh, bpy.types.Mesh) or mesh.get(MARK) is None:
        return own
    uid, held = mesh.session_uid, is_held(item, own)
    if (uid in _changed or (uid, held) not in _files) and not mesh.is_editmode:
        _look(mesh, uid, held=held)
    points = _files.get((uid, held))
    return own if points is None else points


def is_held(item: bpy.types.Object, path: str) -> bool:
    """Whether a file exists and holds the points imported into an object."""
    if not os.path.isfile(path):
        return False
    source = item.data.get(SOURCE) if item.data is not None else None
    return source in (None, _fingerprint(path))


def _fingerprint(path: str) -> str:
    """Return a fingerprint of a file: size and checksum of its start; empty if unreadable."""
    try:
        state = os.stat(path)
        key = path, state.st_mtime_ns, state.st_size
        if key not in _fingerprints:
            with open(path, "rb", opener=files.regular) as file:
                head = file.read(HEAD) or b""  # a system file may return None
            _fingerprints[key] = f"{state.st_size}-{zlib.crc32(head):08x}"
    except OSError:
        return ""
    return _fingerprints[key]


def frame_of(item: bpy.types.Object) -> Matrix:
    """(4, 4) from the frame of `file_of` to the object's."""
    mesh = item.data
    if not isinstance(mesh, bpy.types.Mesh):
        return np.eye(4)
    applied = _applied.get(mesh.session_uid)
    return imported_frame(mesh) if applied is None else applied


def whole_frame(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the frame of a mesh's file to its own, including the common map of its points."""
    return applied_map(mesh) if _differs(mesh) else imported_frame(mesh)


def drawn_frame(item: bpy.types.Object) -> Matrix:
    """Return what `frame_of` does, for an object whose points are drawn. Fast: writes no file."""
    mesh = item.data
    if not isinstance(mesh, bpy.types.Mesh):
        return np.eye(4)
    uid = mesh.session_uid
    if uid not in _maps and not mesh.is_editmode:
        _maps[uid] = whole_frame(mesh)
    return _maps.get(uid, imported_frame(mesh))


def place(mesh: bpy.types.Mesh, frame: Matrix) -> None:
    """Move a new mesh from its file's frame to another one. This is not an edit."""
    mesh[FILE] = mesh[MARK]
    move_to_frame(mesh, frame)
    mark_imported(mesh)


def shift(item: bpy.types.Object, by: Vector) -> None:
    """Move all points of an object in its own frame. This moves its origin and is not an edit."""
    mesh, edited = mesh_of(item), is_edited(item)
    move = BlenderMatrix.Translation(by)
    mesh.transform(move)
    mesh[FRAME] = (np.array(move) @ imported_frame(mesh)).ravel().tolist()
    if not edited:
        mesh[FILE] = mesh.get(FILE, mesh.get(MARK, ""))
        mark_imported(mesh)


def problem(items: Iterable[bpy.types.Object]) -> str:
    """Return why edits of these objects are not drawn, in one line; empty if they are drawn."""
    data = (item.data for item in items)
    return next((_problems[d.session_uid] for d in data if d and d.session_uid in _problems), "")


def remark(items: Iterable[bpy.types.Object]) -> str:
    """Return a one-line warning about the look of these objects after an edit, or nothing."""
    data = (item.data for item in items)
    return next((_mixed[d.session_uid] for d in data if d and d.session_uid in _mixed), "")


def _look(mesh: bpy.types.Mesh, uid: int, *, held: bool) -> None:
    """Update the file of a mesh's points in `_files`, with problems and warnings.

    If the mesh's own file does not hold its points (`held`), they are written.
    """
    if uid in _changed:
        _files.pop((uid, not held), None)
    _changed.discard(uid)
    _problems.pop(uid, None)
    _mixed.pop(uid, None)
    try:
        file = _file(mesh, uid, held=held)
    except AddonError as error:
        _problems[uid], file = str(error), None
    _files[uid, held] = file
    found = targets_of(mesh, drawn(mesh)) if file else []
    if len(found) > 1:
        _mixed[uid] = MIXED.format(mesh.name, found[0].title)


def is_edited(item: bpy.types.Object) -> bool:
    """Whether an object's points differ from the imported ones."""
    mesh = item.data
    return isinstance(mesh, bpy.types.Mesh) and _differs(mesh)


def _differs(mesh: bpy.types.Mesh) -> bool:
    return mesh.get(MARK) not in (None, state_of(mesh))


def put_aside(item: bpy.types.Object) -> None:
    """Store an object's edited points while it shows another result."""
    if is_edited(item):
        object_props(item).aside.add().mesh = mesh_of(item)


def take_back(item: bpy.types.Object) -> None:
    """Restore an object's edits of the result that it shows now, if any were put aside."""
    fresh, edited = item.data, _take_aside(item)
    if edited is not None:
        item.data = edited
        if fresh is not None and not fresh.users:
            bpy.data.batch_remove([fresh])


def drop_aside(item: bpy.types.Object) -> None:
    """Delete the edits of the result that an object shows now."""
    edited = _take_aside(item)
    if edited is not None and not edited.users:
        bpy.data.batch_remove([edited])


def _take_aside(item: bpy.types.Object) -> bpy.types.Mesh | None:
    """Remove and return the edits put aside for the result that an object shows now.

    Edits are found by their original points, so their file may have moved.
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
    """Return a key that tells the points of two files apart, wherever they were placed."""
    return data.get(FILE, data.get(MARK)) if data is not None else None


def look_again(item: bpy.types.Object) -> None:
    """Notice edits by scripts, which Blender may not have reported."""
    if item.data is not None:
        _tell(item.data)


def _tell(data: bpy.types.ID) -> None:
    """Record that a mesh may have been edited."""
    _changed.add(data.session_uid)
    _maps.pop(data.session_uid, None)


def _file(mesh: bpy.types.Mesh, uid: int, *, held: bool) -> str | None:
    """Return the file of a mesh's points, written if needed; a value of `_files`.

    Raises:
        AddonError: it cannot be written, or the points are no Gaussians any more.
    """
    state = state_of(mesh)
    if state == mesh[MARK]:
        _applied.pop(uid, None)
        if held:
            _written.pop(uid, None)
            return None
    # All edits of a mesh use one name: while it is read again, its last state is drawn.
    path = Path(bpy.app.tempdir) / f"{PREFIX}{uid}.ply"
    if state == _written.get(uid) and path.is_file():
        return str(path)
    found = cloud_of(mesh)
    if found is None:
        how = "drawn as it was imported" if held else "not drawn, because its PLY file is missing"
        raise AddonError(f"'{mesh.name}' is {how}: its points lack attributes of Gaussians.")
    cloud, applied = found
    if state != mesh[MARK]:
        _applied[uid] = applied
    if not len(cloud):
        return ""
    try:
        write_splats(path, cloud, durable=False)
    except (EngineError, OSError) as error:
        raise AddonError(f"The points of '{mesh.name}' are not drawn: {error}") from error
    _written[uid] = state
    return str(path)


def state_of(mesh: bpy.types.Mesh) -> str:
    """Return a text that changes when points are deleted, hidden, moved or changed."""
    found = zlib.crc32(clouds.positions_of(mesh).data)
    found = zlib.crc32(hidden(mesh).data, found)
    for name in SHAPE:
        numbers = values(mesh, name)
        if numbers is not None:
            found = zlib.crc32(numbers.data, found)
    return f"{len(mesh.vertices)}-{found:08x}"


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """Record meshes that Blender reports as changed."""
    for update in graph.updates if _files or _maps else ():
        changed = update.id if update.is_updated_geometry else None
        if isinstance(changed, bpy.types.Mesh) and changed.original is not None:
            _tell(changed.original)


@persistent
def _after_undo(*_: object) -> None:
    _changed.update(uid for uid, _ in _files)
    _maps.clear()


@persistent
def _after_load(*_: object) -> None:
    _forget()
    for item in bpy.data.objects:
        if item.mode != "OBJECT":  # saved so; it gets into that mode only after this
            file_of(item)


def _forget() -> None:
    for known in (_files, _written, _changed, _maps, _problems, _mixed, _applied, _fingerprints):
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
    """Stop following changes."""
    _leave()
    _forget()
