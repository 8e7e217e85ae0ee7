"""What decides the mask of a photo, as a hash: a mask whose inputs are the same is kept.

These are the photo with its camera and strokes, the strokes that the work begins with, the boxes,
and the model. Strokes that correct another photo are none of them: masks that a person has looked
at stay as they are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..formats.files import sha256
from ..formats.scribbles import Stroke
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..photos.headers import content_digest, unreadable
from .grab_cut import fenced
from .views import View

VERSION = 2  # increase it if masks of the same inputs become others
Strokes = Mapping[str, tuple[Stroke, ...]]


def basis_digest(
    model: Path | None, scene: SfmScene, roi: OrientedBox, rois: Sequence[OrientedBox]
) -> str:
    """Hash of what carries masks from photo to photo: the model, or the sparse points.

    Args:
        model: the PLY; None: there is none.
        scene: with the sparse points.
        roi: the box.
        rois: all boxes, which share the Gaussians.

    Raises:
        SceneError: the model cannot be read.
    """
    if model is None:
        points = hashlib.sha256(np.ascontiguousarray(scene.points).tobytes()).hexdigest()
        return _hash([points, _box(roi)])
    try:
        found = sha256(model)
    except OSError as error:
        raise SceneError(f"Cannot read {model} ({error.strerror}).") from error
    return _hash([found, _box(roi), *(_box(each) for each in rois)])


def mask_inputs(views: Iterable[View], strokes: Strokes, basis: str) -> dict[str, str]:
    """The hash of each photo's inputs.

    Args:
        views: the photos.
        strokes: on photos, by their names.
        basis: of `basis_digest`.

    Raises:
        PhotoError: a photo cannot be read.
    """
    views = list(views)
    drawn = [view for view in views if view.is_scribbled]
    first = [view for view in drawn if fenced(view).any()] or drawn
    common = _hash([VERSION, basis, *((each.name, _lines(strokes, each)) for each in first)])
    return {view.name: _hash([common, _photo(view), _lines(strokes, view)]) for view in views}


def _photo(view: View) -> str:
    try:
        content = content_digest(view.photo.path)
    except OSError as error:
        raise unreadable(view.photo.path, error) from error
    return _hash([content, view.photo.lens, view.camera, view.part, view.world_to_camera.tolist()])


def _lines(strokes: Strokes, view: View) -> list[tuple[str, float, list[float]]]:
    lines = strokes.get(view.name, ())
    return [(line.kind, line.width, line.points.tolist()) for line in lines]


def _box(roi: OrientedBox) -> list[list[float]]:
    return [*roi.world_to_box.tolist(), roi.half_extents.tolist()]


def _hash(values: Sequence[object]) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()
