"""Saves Gaussians in a .blend with or without their view-dependent colour.

That colour is two thirds of the size. If the user leaves it out, it is removed from the meshes
while the file is saved, but only if the PLY can restore it: the file exists, and the points are
still the imported ones. It is restored when the .blend is opened.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..blender import following, is_local, persistent
from ..geometry.splat_cloud import read_splats
from ..properties import object_props, scene_props
from . import clouds, edits, lookup
from .splat_attributes import SH_NAMES, Float32, values

LEFT_OUT = "roigs_left_out"
"""Custom property of a mesh in a .blend that was saved without its view-dependent colour."""

_taken: dict[int, dict[str, Float32]] = {}
"""Mesh (`session_uid`) -> its view-dependent colour while the file is saved."""


def bring_back(scene: bpy.types.Scene) -> None:
    """Restore view-dependent colour that was left out, from the meshes' PLYs."""
    for item, mesh in _of(scene):
        if not mesh.get(LEFT_OUT) or not edits.is_held(item, object_props(item).ply):
            continue
        try:
            sh = read_splats(object_props(item).ply).sh
        except (OSError, ValueError):
            continue
        if len(sh) == len(mesh.vertices):
            bands = enumerate(SH_NAMES[: sh.shape[1] - 1], start=1)
            _give(mesh, {name: sh[:, k] for k, name in bands})


def is_left_out(scene: bpy.types.Scene) -> bool:
    """Whether some Gaussians lack their view-dependent colour."""
    return any(mesh.get(LEFT_OUT) for _, mesh in _of(scene))


def _of(scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Object, bpy.types.Mesh]]:
    """The Gaussian objects whose meshes can be changed now."""
    for item in lookup.splats(scene):
        mesh = item.data
        if isinstance(mesh, bpy.types.Mesh) and is_local(mesh) and not mesh.is_editmode:
            yield item, mesh


def _give(mesh: bpy.types.Mesh, columns: dict[str, Float32]) -> None:
    for name, numbers in columns.items():
        clouds.set_attribute(mesh, name, "FLOAT_VECTOR", numbers)
    mesh.pop(LEFT_OUT, None)


@persistent
def _before_save(*_: object) -> None:
    for scene in bpy.data.scenes:
        if scene_props(scene).carry_colour:
            continue
        for item, mesh in _of(scene):
            if edits.is_held(item, object_props(item).ply) and not edits.is_edited(item):
                _take(mesh)


def _take(mesh: bpy.types.Mesh) -> None:
    names = [name for name in SH_NAMES if name in mesh.attributes]
    if names:
        columns = {name: values(mesh, name) for name in names}
        _taken[mesh.session_uid] = {n: v for n, v in columns.items() if v is not None}
        mesh[LEFT_OUT] = True
    for name in names:
        mesh.attributes.remove(mesh.attributes[name])


@persistent
def _after_save(*_: object) -> None:
    for mesh in bpy.data.meshes if _taken else ():
        if (columns := _taken.pop(mesh.session_uid, None)) is not None:
            _give(mesh, columns)


_follow, _leave = following(
    ("save_pre", _before_save), ("save_post", _after_save), ("save_post_fail", _after_save)
)


def register() -> None:
    """Follow saving."""
    _follow()


def unregister() -> None:
    """Stop following it."""
    _leave()
