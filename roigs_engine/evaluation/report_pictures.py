"""Pictures for the report's page: crops of a photo, of the baseline and of the result."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import PosedImage, SfmScene
from ..photos.decode import load_photo
from ..photos.headers import PhotoError
from ..rasterize.image_files import to_uint8
from ..rasterize.view import render_view
from .crops import choose_views, crop_window, shown_rows
from .scores import Evaluation, ModelScore
from .views import EvaluatedModel

SIDE = 720  # pixels of a picture's longer side, at most
ENLARGED = 360  # what is smaller is enlarged to at least this
QUALITY = 90  # of JPEG


@dataclass(frozen=True, kw_only=True)
class Shown:
    """One picture.

    Attributes:
        name: `photo`, or the model's.
        psnr: in the box, dB.
        jpeg: the file.
    """

    name: str
    psnr: float | None
    jpeg: bytes


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A box on one photo.

    Attributes:
        roi: the box's name.
        view: the photo's name.
        label: why this photo is shown.
        size: width and height of the pictures, pixels.
        pictures: the photo, then the models; the last one is the result.
    """

    roi: str
    view: str
    label: str
    size: tuple[int, int]
    pictures: tuple[Shown, ...]


def comparisons(
    evaluation: Evaluation,
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    *,
    context: Context = QUIET,
) -> list[Comparison]:
    """The photos and models that `crops.write_crops` shows; photos that are lost are left out."""
    found = []
    for roi in rois:
        scores = evaluation.roi(roi.name)
        shown = shown_rows(scores, evaluation.baseline)
        if not scores.views or not shown:
            continue
        by_name = {m.name: m for m in models if m.rois is None or roi.name in m.rois}
        panels = [(row, by_name[row.model]) for row in shown]
        for view, label in choose_views(shown[-1], shown[0]).items():
            context.check_cancelled()
            try:
                found.append(_comparison(scene.image(view), roi, panels, label))
            except PhotoError:
                continue  # `write_crops` has said so
    return found


def _comparison(
    image: PosedImage,
    roi: OrientedBox,
    panels: Sequence[tuple[ModelScore, EvaluatedModel]],
    label: str,
) -> Comparison:
    rows, columns = crop_window(roi, image.camera, image.world_to_camera)
    size, jpeg = _jpeg(load_photo(image)[rows, columns])
    pictures = [Shown(name="photo", psnr=None, jpeg=jpeg)]
    for row, model in panels:
        view = render_view(model.gaussians, image.camera, image.world_to_camera)
        psnr = next((score.roi_psnr for score in row.views if score.view == image.name), None)
        _, jpeg = _jpeg(to_uint8(view.image)[rows, columns])
        pictures.append(Shown(name=row.model, psnr=psnr, jpeg=jpeg))
    return Comparison(
        roi=roi.name, view=image.name, label=label, size=size, pictures=tuple(pictures)
    )


def _jpeg(picture: NDArray[np.uint8]) -> tuple[tuple[int, int], bytes]:
    """Size and file of a picture; small ones show their pixels."""
    image = Image.fromarray(np.ascontiguousarray(picture))
    factor = -(-ENLARGED // max(image.size))
    if factor > 1:
        size = (image.width * factor, image.height * factor)
        image = image.resize(size, Image.Resampling.NEAREST)
    else:
        image.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=QUALITY, subsampling=0)
    return image.size, out.getvalue()
