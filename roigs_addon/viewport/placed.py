"""Data of a GPU set's objects: for sorting and for drawing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from .objects import FileKey, SplatObject
from .sorting import Segment, SortingView
from .view import View

Files = tuple[FileKey, ...]
Ranges = tuple[tuple[int, int], ...]
Float32 = NDArray[np.float32]

NEAR = 0.01
"""Gaussians nearer to the eye than this (units of their object) are not drawn, as in the engine."""


def objects_of(files: Files, objects: Sequence[SplatObject]) -> list[SplatObject | None]:
    """Return the object of each file of a set; None if there is none.

    They are matched by path, visible objects first. While a changed file is being read, the
    Gaussians of its last state still belong to the object.
    """
    by_path: dict[str, list[SplatObject]] = {}
    for item in sorted(objects, key=lambda item: not item.visible):
        by_path.setdefault(item.file.path, []).append(item)
    return [by_path[f.path].pop(0) if by_path.get(f.path) else None for f in files]


def sorting_view(
    files: Files, ranges: Ranges, extent: float, objects: Sequence[SplatObject], view: Matrix
) -> SortingView:
    """Return what defines depths along the camera's axis, for the visible objects of a set.

    Args:
        files, ranges, extent: of the set.
        objects: all objects.
        view: world -> camera.
    """
    segments = []
    for range_, item in zip(ranges, objects_of(files, objects), strict=True):
        if item is not None and item.visible:
            row = np.array((view @ item.matrix)[2])
            segments.append(Segment(*range_, axis=-row[:3], offset=float(-row[3])))
    return SortingView(tuple(segments), extent)


def object_texels(
    files: Files, objects: Sequence[SplatObject], view: View, photo_focals: Sequence[float]
) -> Float32:
    """(objects, 6, 4) parameters of each object for drawing.

    Object -> camera as three rows; eye or viewing direction, and least depth; gains and density;
    focal length of its photos in px, or 0.
    """
    texels = np.zeros((max(1, len(files)), 6, 4), np.float32)
    texels[: len(files), 5, 0] = photo_focals
    texels[:, 3, 3] = np.inf  # nothing is so far away, so a deleted object is not drawn
    perspective = view.projection[3][3] == 0.0
    for texel, item in zip(texels, objects_of(files, objects), strict=False):
        if item is None or not item.visible:
            continue
        matrix = view.matrix @ item.matrix
        scale = abs(matrix.to_3x3().determinant()) ** (1 / 3)
        if not scale:
            continue
        back = matrix.inverted()
        texel[:3], texel[4] = np.array(matrix)[:3], (*item.gains, item.density)
        if perspective:
            texel[3, :3], texel[3, 3] = np.array(back.translation), NEAR * scale
        else:
            sight = back.to_3x3() @ Vector((0, 0, -1))
            texel[3, :3], texel[3, 3] = np.array(sight.normalized()), -np.inf
    return texels
