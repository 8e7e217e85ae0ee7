"""Moves a whole scene by its root, and writes its placement to a file beside the model.

The file follows undo and redo: the undo of a step restores its earlier content.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix as BlenderMatrix

from ..blender import following, is_local, persistent, view_layer_of
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..properties import scene_props
from ..shared import EngineError, files, transforms
from ..shared import scene_transform as stored
from ..windows import move_views
from . import cameras, lookup

MOVED = ("ROOT", "CAMERA", "POINTS", "ROI", "SPLATS")
"""Kinds of objects that are moved."""

_written: dict[Path, str] = {}
"""File -> the text that this session has written; empty if it has removed the file."""

_own: dict[Path, set[str]] = {}
"""File -> all texts that this session has written. A .blend may hold another text, which is not in
the file."""

_found: dict[Path, str] = {}
"""File -> its text before this session wrote it; empty if there was none."""

_scenes: dict[Path, int] = {}
"""File -> `session_uid` of the scene whose undo steps the file follows."""

_roots: dict[Path, Matrix] = {}
"""File -> the root's matrix for which the 3D views are set."""


def root_of(scene: bpy.types.Scene) -> bpy.types.Object:
    """The scene's root.

    Raises:
        AddonError: there is none, or it is stretched or mirrored.
    """
    root: bpy.types.Object | None = scene_props(scene).root
    if root is None or root.name not in scene.objects:
        raise AddonError("There is no scene to place. Reconstruct photos or import cameras first.")
    view_layer_of(bpy.context).update()  # after an undo, as for F9, `matrix_world` is outdated
    flaw = _flaw(lookup.matrix_world(root))
    if flaw:
        raise AddonError(f"'{root.name}' cannot be placed: {flaw}. Clear its transformation first.")
    if root.library is not None:
        raise AddonError(f"'{root.name}' is linked from another .blend. Place the scene there.")
    return root


def _flaw(matrix: Matrix) -> str:
    """Return why a root cannot have this matrix; empty if it can."""
    if not (np.abs(matrix) < lookup.FAR).all():  # catches NaN too
        return "it is too far away or too large"
    return transforms.similarity_flaw(matrix)


def move(scene: bpy.types.Scene, matrix: Matrix) -> None:
    """Apply a similarity (4, 4) in the world to the model's objects; other objects stay.

    Raises:
        AddonError: there is no model, the root is stretched or mirrored, does not stay where it is
            put, or would have no valid place.
    """
    root, path = root_of(scene), _file(scene)
    if flaw := _flaw(matrix @ lookup.matrix_world(root)):
        raise AddonError(f"The scene cannot be moved there: {flaw}. Pick other points.")
    if path is not None:
        _roots.setdefault(path, lookup.matrix_world(root))
    there = (item for kind in MOVED for item in lookup.of_kind(scene, kind))
    own = {item for item in there if is_local(item)} | {root}
    tops = [item for item in own if not own.intersection(_ancestors(item))]
    graph = bpy.context.evaluated_depsgraph_get()
    before = {item: lookup.stands(item, graph) for item in tops}
    _put({item: matrix @ place for item, place in before.items()})
    if root in before and not _stays(scene, root, matrix @ before[root]):
        _put(before)
        raise AddonError(f"'{root.name}' is animated or has constraints. Remove them first.")
    _move_cursor(scene, matrix)
    _follow_root(scene, path, matrix)


def _move_cursor(scene: bpy.types.Scene, matrix: Matrix) -> None:
    """Move the 3D cursor along, unless it is at the world's origin."""
    if scene.cursor.location.length > 0:
        scene.cursor.matrix = BlenderMatrix((matrix @ np.array(scene.cursor.matrix)).tolist())


def _put(places: dict[bpy.types.Object, Matrix]) -> None:
    for item, place in places.items():
        item.matrix_world = BlenderMatrix(place.tolist())
    view_layer_of(bpy.context).update()


def _stays(scene: bpy.types.Scene, root: bpy.types.Object, wanted: Matrix) -> bool:
    """Whether the root is where it was put, even after the frame is evaluated again."""
    if root.animation_data is not None:
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    found = lookup.matrix_world(root)
    return bool(np.abs(found - wanted).max() <= 1e-3 * np.abs(wanted).max())


def _ancestors(item: bpy.types.Object) -> list[bpy.types.Object]:
    found = []
    while (parent := item.parent) is not None:
        found.append(parent)
        item = parent
    return found


def keep(scene: bpy.types.Scene) -> Path:
    """Write the model's placement beside it, for other .blend files and the engine.

    Returns:
        The file.

    Raises:
        AddonError: it cannot be written.
    """
    root, path = root_of(scene), _file(scene)
    known = (lookup.photo_record(item) for item in lookup.cameras(scene).values())
    centres = {p.name: -p.pose[:3, :3].T @ p.pose[:3, 3] for p in known if p is not None}
    if path is None or not centres:
        raise AddonError("There are no photos to identify the model. Import it again.")
    try:
        if not os.path.isdir(path.parent):
            raise AddonError(f"There is no folder {path.parent}.")
        before = _text(path)
        placement = stored.SceneTransform(
            matrix=_metres(scene) @ lookup.matrix_world(root),
            cameras=stored.some_cameras(centres),
        )
        text = stored.document(placement, stored.read_transforms(path))
        files.write_text(path, text)
    except (EngineError, OSError) as error:
        raise AddonError(str(error)) from error
    _found.setdefault(path, before)
    _own.setdefault(path, set()).add(text)
    _written[path], _scenes[path] = text, scene.session_uid
    props = scene_props(scene)
    props.placement, props.placement_key = text, _key(scene, root)
    return path


def place_as_kept(scene: bpy.types.Scene, root: bpy.types.Object, matrix: Matrix) -> None:
    """Put a new root at the placement from the file."""
    root.matrix_world = BlenderMatrix((np.linalg.inv(_metres(scene)) @ matrix).tolist())
    scene_props(scene).placement_key = _key(scene, root)


def is_kept(scene: bpy.types.Scene) -> bool:
    """Whether the root stands at the file's placement, as far as this .blend knows."""
    props = scene_props(scene)
    return props.root is not None and props.placement_key == _key(scene, props.root)


def _file(scene: bpy.types.Scene) -> Path | None:
    colmap = scene_props(scene).colmap
    return stored.transform_file(Path(bpy.path.abspath(colmap))) if colmap else None


def _text(path: Path) -> str:
    """Return the text of a file, empty if there is none; OSError or ValueError if unreadable."""
    return files.read_bytes(path).decode("utf-8", "replace") if os.path.lexists(path) else ""


def _metres(scene: bpy.types.Scene) -> Matrix:
    """(4, 4) scaling from Blender's units to metres."""
    units = scene.unit_settings
    factor = 1.0 if units.system == "NONE" else units.scale_length
    return np.diag([factor, factor, factor, 1.0])


def _key(scene: bpy.types.Scene, root: bpy.types.Object) -> str:
    """Return a text that changes when the root is moved, with fewer digits than Blender has."""
    numbers = (_metres(scene) @ lookup.matrix_world(root))[:3].ravel()
    size = float(np.abs(numbers).max())
    return " ".join(f"{number / size:.5f}" for number in numbers) + f" {size:.5g}"


def _follow_root(scene: bpy.types.Scene, path: Path | None, moved: Matrix) -> None:
    """Move the 3D views and fit the cameras' clip ranges, so that both show the same as before."""
    cameras.fit_clips(scene, lookup.root_scale(scene))
    move_views(scene, moved)
    if path is not None:
        _roots[path] = lookup.matrix_world(scene_props(scene).root)


@persistent
def _after_undo(scene: bpy.types.Scene, *_: object) -> None:
    """Write the text of the current undo step to the scene's file."""
    path = _file(scene) if isinstance(scene, bpy.types.Scene) else None
    if path is None or path not in _written or _scenes[path] != scene.session_uid:
        return
    text = scene_props(scene).placement
    wanted = text if text in _own[path] else _found[path]
    if wanted == _written[path]:
        return
    with suppress(EngineError, OSError):
        if wanted:
            files.write_text(path, wanted)
        else:
            path.unlink(missing_ok=True)
        _written[path] = wanted
    before = _roots.get(path)
    if before is not None:
        view_layer_of(bpy.context).update()  # `matrix_world` may be outdated
        now = lookup.matrix_world(scene_props(scene).root)
        _follow_root(scene, path, now @ np.linalg.inv(before))


@persistent
def _forget(*_: object) -> None:
    """Forget all files: undo steps of another .blend do not belong to them."""
    for known in (_written, _own, _found, _scenes, _roots):
        known.clear()


_follow, _leave = following(
    ("undo_post", _after_undo), ("redo_post", _after_undo), ("load_post", _forget)
)


def register() -> None:
    """Follow undo and redo."""
    _follow()


def unregister() -> None:
    """Stop following them."""
    _leave()
    _forget()
