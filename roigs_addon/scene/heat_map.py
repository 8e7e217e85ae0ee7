"""The heat map: colours Gaussians by the number of directions from which photos see them.

The confidence is in attributes of the points (`confidence.COLUMNS`): it is saved, and follows the
points through edits. The colours are a file in Blender's temporary folder, drawn in place of the
object's own.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import following, mesh_of, persistent
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..geometry.splat_cloud import SH_C0, write_splats
from ..shared import EngineError, confidence
from ..windows import redraw
from . import clouds, display
from .splat_attributes import cloud_of, drawn, values

DIRECTIONS = confidence.COLUMNS.index("directions")
NAME = "heat map"
PREFIX = "roigs-heat-"
"""Prefix of the names of files with colours."""

_shown: dict[int, tuple[str, Matrix] | None] = {}
"""Mesh (`session_uid`) -> its file and the file's frame; None if it must be written again."""

_most: list[float] = []
"""Number of directions of the brightest colour; empty if no heat map is shown."""


def keep(item: bpy.types.Object, known: NDArray[np.float32]) -> None:
    """Write the confidence of an object's points (N, 3) to its attributes."""
    mesh = mesh_of(item)
    for name, column in zip(confidence.COLUMNS, known.T, strict=True):
        if (before := mesh.attributes.get(name)) is not None:
            mesh.attributes.remove(before)
        clouds.set_attribute(mesh, name, "FLOAT", np.ascontiguousarray(column))


def directions(item: bpy.types.Object) -> NDArray[np.float32] | None:
    """(N,) number of directions from which photos see each point, NaN if unknown.

    None if the object has no confidence values.
    """
    if not isinstance(item.data, bpy.types.Mesh):
        return None
    found = values(item.data, confidence.COLUMNS[DIRECTIONS])
    return None if found is None else found[:, 0]


def show(items: Iterable[bpy.types.Object]) -> None:
    """Show those of these objects as a heat map that have confidence values.

    AddonError: there are none, or the colours cannot be written.
    """
    known = {item: found for item in items if (found := directions(item)) is not None}
    if not known:
        raise AddonError("These Gaussians have no confidence values yet. Click Find Confidence.")
    hide()
    most = confidence.most_directions(np.concatenate([*known.values()]))
    try:
        for item, found in known.items():
            _heat(item, found, most)
            display.show_exactly(item, NAME)
    except (EngineError, OSError) as error:
        hide()
        raise AddonError(f"The heat map cannot be shown: {error}") from error
    _most[:] = [most]
    redraw()


def _heat(item: bpy.types.Object, found: NDArray[np.float32], most: float) -> None:
    """Write an object's file of colours."""
    mesh, whole = mesh_of(item), cloud_of(mesh_of(item))
    if whole is None or not len(whole[0]):
        return
    cloud, frame = whole
    colours = confidence.colours(found[drawn(mesh)], most)
    sh = ((colours - 0.5) / SH_C0)[:, None].astype(np.float32)
    path = Path(bpy.app.tempdir) / f"{PREFIX}{mesh.session_uid}.ply"
    write_splats(path, replace(cloud, sh=sh), durable=False)
    _shown[mesh.session_uid] = str(path), frame


def hide() -> None:
    """Show the Gaussians in their own colours again."""
    _shown.clear()
    _most.clear()
    display.show_again(bpy.data.objects, NAME)
    redraw()


def most() -> float | None:
    """Return the number of directions of the brightest colour; None without a heat map."""
    return _most[0] if _most and _shown else None


def shown(item: bpy.types.Object) -> tuple[str, Matrix] | None:
    """Return the file of an object's heat map and the file's frame; None if it is not shown."""
    mesh = item.data
    if not isinstance(mesh, bpy.types.Mesh) or mesh.session_uid not in _shown:
        return None
    if _shown[mesh.session_uid] is None and not mesh.is_editmode:  # the points were edited
        del _shown[mesh.session_uid]
        found = directions(item)
        if found is not None and _most:
            with suppress(EngineError, OSError):
                _heat(item, found, _most[0])
    return _shown.get(mesh.session_uid)


def few(item: bpy.types.Object, fewer: int) -> NDArray[np.bool_]:
    """(N,) whether photos see each point from fewer directions than `fewer`.

    AddonError: the object has no confidence values.
    """
    found = directions(item)
    if found is None:
        raise AddonError(f"'{item.name}' has no confidence values yet. Click Find Confidence.")
    return np.asarray(found < fewer)


def asked(items: Iterable[bpy.types.Object]) -> bool:
    """Whether any of these objects has confidence values."""
    name = confidence.COLUMNS[DIRECTIONS]
    return any(isinstance(i.data, bpy.types.Mesh) and name in i.data.attributes for i in items)


@persistent
def _on_change(_: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """After every change, mark points that may have been edited to get their colours again."""
    for update in graph.updates if _shown else ():
        changed = update.id if update.is_updated_geometry else None
        mesh = changed.original if isinstance(changed, bpy.types.Mesh) else None
        if mesh is not None and mesh.session_uid in _shown:
            _shown[mesh.session_uid] = None


@persistent
def _after_undo(*_: object) -> None:
    _shown.update(dict.fromkeys(_shown))


@persistent
def _after_load(*_: object) -> None:
    """The file may have been saved while a heat map was shown."""
    hide()


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
    _shown.clear()
    _most.clear()
