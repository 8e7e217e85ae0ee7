"""Crops of boxes on test photos, with the photo beside the models: files and report page.

Each box has up to four photos. To be fair, three are those with the largest, the median and the
least gain of the result over the baseline. The fourth is the nearest one.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..context import QUIET, Context
from ..formats.files import own_folder
from ..formats.names import safe_name
from ..formats.run_files import CROPS
from ..model.roi import EDGES, NEAR_SHARE, OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene
from ..photos.decode import load_as_taken
from ..photos.exposures import exposed
from ..photos.headers import PhotoError
from ..rasterize.image_files import save_png, to_uint8
from ..rasterize.view import render_view
from .metrics import bounding_box
from .scores import Evaluation, ModelScore, RoiScores
from .views import EvaluatedModel

HEIGHT = 480  # approximate height of a panel, pixels
MARGIN = 0.1  # of the silhouette's bounding box, on each side
STRIP = 26  # height of the label under a panel, pixels
GAP = 4  # pixels between panels
INK, PAPER, OUTLINE = (235, 235, 235), (24, 24, 24), (255, 160, 0)
SIDE = 720  # largest longer side of a picture in the page, pixels
ENLARGED = 360  # smaller pictures are enlarged to at least this
QUALITY = 90  # of JPEG

Pixels = NDArray[np.uint8]  # (H, W, 3)
Panels = Sequence[tuple[ModelScore, EvaluatedModel]]


@dataclass(frozen=True, kw_only=True)
class Shown:
    """One picture of the report's page."""

    name: str  # `photo`, or the model's
    psnr: float | None  # in the box, dB
    jpeg: bytes


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A box on one photo, for the report's page.

    Attributes:
        label: why this photo is shown.
        size: width and height of the pictures, pixels.
        pictures: the photo, then the models; the last one is the result.
    """

    roi: str
    view: str
    label: str
    size: tuple[int, int]
    pictures: tuple[Shown, ...]


def write_crops(
    evaluation: Evaluation,
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    run_dir: Path,
    *,
    names: Sequence[str] | None = None,
    context: Context = QUIET,
) -> list[Path]:
    """Write the images of all boxes; return the files, box by box.

    The evaluation decides which photos to show. `names` are the rows to show after the photo, the
    result last; None for the baseline and the box's last row.
    """
    written: list[Path] = []
    for roi, panels, chosen in _boxes(evaluation, models, rois, names):
        folder = own_folder(run_dir, CROPS, safe_name(roi.name))
        for name, label in chosen.items():
            context.check_cancelled()
            picture = partial(_side_by_side, scene.image(name), roi, panels, label)
            written += _saved(folder / f"{safe_name(name)}.png", picture, context)
        context.check_cancelled()
        median = list(chosen)[min(1, len(chosen) - 1)]  # the second one, or the only one
        picture = partial(_overview, scene.image(median), roi, panels[-1][1])
        written += _saved(folder / "overview.png", picture, context)
    return written


def comparisons(
    evaluation: Evaluation,
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    *,
    context: Context = QUIET,
) -> list[Comparison]:
    """Return the photos and models that `write_crops` shows, without lost photos."""
    found = []
    for roi, panels, chosen in _boxes(evaluation, models, rois, None):
        for view, label in chosen.items():
            context.check_cancelled()
            try:
                crops = _crops(scene.image(view), roi, panels)
            except PhotoError:
                continue  # `write_crops` has warned of it
            files = [(name, psnr, *_jpeg(picture)) for name, psnr, picture in crops]
            pictures = tuple(Shown(name=n, psnr=p, jpeg=jpeg) for n, p, _, jpeg in files)
            size = files[0][2]
            found.append(
                Comparison(roi=roi.name, view=view, label=label, size=size, pictures=pictures)
            )
    return found


def _boxes(
    evaluation: Evaluation,
    models: Sequence[EvaluatedModel],
    rois: Sequence[OrientedBox],
    names: Sequence[str] | None,
) -> Iterator[tuple[OrientedBox, Panels, dict[str, str]]]:
    """Yield the boxes with scores, their rows to show with the models, and `choose_views`."""
    for roi in rois:
        scores = evaluation.roi(roi.name)
        shown = shown_rows(scores, evaluation.baseline, names)
        if scores.views and shown:
            by_name = {m.name: m for m in models if m.rois is None or roi.name in m.rois}
            panels = [(row, by_name[row.model]) for row in shown]
            yield roi, panels, choose_views(shown[-1], shown[0])


def _saved(path: Path, picture: Callable[[], Pixels], context: Context) -> list[Path]:
    """Write a picture and return its path; empty if its photo was lost after the evaluation."""
    try:
        save_png(path, picture())
    except PhotoError as error:
        context.warn(f"{error.message} There is no {path.name} of it.")
        return []
    return [path]


def choose_views(result: ModelScore, baseline: ModelScore) -> dict[str, str]:
    """Return photo -> label: largest, median, least gain in ROI PSNR, and nearest, in this order.

    With fewer than three photos, all are shown; a photo has its first label. If result and baseline
    are the same model, its PSNR replaces the gain.
    """
    before = {view.view: view.roi_psnr for view in baseline.views}
    gain = {view.view: view.roi_psnr - before.get(view.view, 0.0) for view in result.views}
    word = "gain"
    if result.model == baseline.model:
        gain, word = before, "PSNR"
    order = sorted(gain, key=lambda name: (-gain[name], name))
    picks: dict[str, str] = {}
    for index, label in ((0, "largest"), (len(order) // 2, "median"), (-1, "least")):
        picks.setdefault(order[index], f"{label} {word}")
    distances = {view.view: view.distance for view in result.views if view.distance is not None}
    if distances:
        picks.setdefault(min(distances, key=lambda name: (distances[name], name)), "nearest")
    return picks


def shown_rows(
    scores: RoiScores, baseline: str, names: Sequence[str] | None = None
) -> list[ModelScore]:
    """Return the rows to show; the last one is compared with the first."""
    rows = {row.model: row for row in scores.rows}
    if names is not None:
        return [rows[name] for name in names if name in rows]
    if not rows:
        return []
    last = scores.rows[-1]
    return [rows[baseline], last] if baseline in rows and baseline != last.model else [last]


def _crops(
    image: PosedImage, roi: OrientedBox, panels: Panels
) -> list[tuple[str, float | None, Pixels]]:
    """Return name, ROI PSNR and pixels of the crop window, of the photo and then of each model."""
    rows, columns = crop_window(roi, image.camera, image.world_to_camera)
    photo = load_as_taken(image)[rows, columns]
    found: list[tuple[str, float | None, Pixels]] = [("photo", None, photo)]
    for row, model in panels:
        psnr = next((score.roi_psnr for score in row.views if score.view == image.name), None)
        found.append((row.model, psnr, _rendered(model, image)[rows, columns]))
    return found


def _rendered(model: EvaluatedModel, image: PosedImage) -> Pixels:
    """The model from a photo's camera, in the photo's exposure."""
    view = render_view(model.gaussians, image.camera, image.world_to_camera)
    values = view.image.detach().clamp(0, 1)
    return to_uint8(torch.from_numpy(exposed(values.cpu().numpy(), image.exposure)))


def crop_window(roi: OrientedBox, camera: Camera, world_to_camera: Float64) -> tuple[slice, slice]:
    """Return rows and columns of the silhouette's bounding box, widened by 10 %; all if unseen."""
    mask = torch.from_numpy(roi.silhouette(camera, world_to_camera))
    tight = bounding_box(mask)
    if tight is None:
        return slice(0, camera.height), slice(0, camera.width)
    longer = max(side.stop - side.start for side in tight)
    window = bounding_box(mask, margin=round(MARGIN * longer))
    assert window is not None
    return window


def _side_by_side(image: PosedImage, roi: OrientedBox, panels: Panels, label: str) -> Pixels:
    """Draw the photo's crop window, then each model's, labelled."""
    shown: list[Image.Image] = []
    for name, psnr, picture in _crops(image, roi, panels):
        caption = name if psnr is None else f"{name}  {psnr:.2f} dB"
        shown.append(_panel(picture, caption if shown else f"photo ({label})"))
    return _joined(shown)


def _panel(picture: Pixels, caption: str) -> Image.Image:
    """Draw the image about `HEIGHT` pixels high, with its caption below.

    Small images are enlarged by an integer factor without interpolation. Interpolation would hide
    the real resolution.
    """
    height, width = picture.shape[:2]
    shown = Image.fromarray(np.ascontiguousarray(picture))
    if height <= HEIGHT:
        factor = max(1, round(HEIGHT / height))
        shown = shown.resize((width * factor, height * factor), Image.Resampling.NEAREST)
    else:
        size = (max(1, round(width * HEIGHT / height)), HEIGHT)
        shown = shown.resize(size, Image.Resampling.LANCZOS)
    font = ImageFont.load_default(size=15)
    needed = int(font.getlength(caption)) + 12
    panel = Image.new("RGB", (max(shown.width, needed), shown.height + STRIP), PAPER)
    panel.paste(shown, (0, 0))
    ImageDraw.Draw(panel).text((6, shown.height + 4), caption, fill=INK, font=font)
    return panel


def _joined(panels: Sequence[Image.Image]) -> Pixels:
    """Join the panels side by side."""
    width = sum(panel.width for panel in panels) + GAP * (len(panels) - 1)
    sheet = Image.new("RGB", (width, max(panel.height for panel in panels)), PAPER)
    left = 0
    for panel in panels:
        sheet.paste(panel, (left, 0))
        left += panel.width + GAP
    return np.asarray(sheet)


def _jpeg(picture: Pixels) -> tuple[tuple[int, int], bytes]:
    """Return size and JPEG of a picture; small pictures are enlarged without interpolation."""
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


def _overview(image: PosedImage, roi: OrientedBox, model: EvaluatedModel) -> Pixels:
    """The whole photo and the whole render, both with the box's edges."""
    pictures = (load_as_taken(image), "photo"), (_rendered(model, image), model.name)
    panels = []
    for picture, caption in pictures:
        drawn = Image.fromarray(np.ascontiguousarray(picture))
        pen = ImageDraw.Draw(drawn)
        for line in box_lines(roi, image.camera, image.world_to_camera):
            pen.line(line, fill=OUTLINE, width=max(1, image.camera.height // 300))
        panels.append(_panel(np.asarray(drawn), f"{caption} ({image.name})"))
    return _joined(panels)


def box_lines(
    roi: OrientedBox, camera: Camera, world_to_camera: Float64
) -> list[tuple[float, float, float, float]]:
    """Return all edges of the box as x0, y0, x1, y1 in pixels, clipped to the image."""
    corners = roi.corners() @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    near = NEAR_SHARE * roi.diagonal
    lines = []
    for a, b in EDGES:
        ends = _clipped_line(corners[a], corners[b], np.array([0.0, 0.0, 1.0]), -near)
        # The image's four sides as planes through the camera: n . p >= 0 is inside.
        for normal in (
            (camera.fx, 0.0, camera.cx),
            (-camera.fx, 0.0, camera.width - camera.cx),
            (0.0, camera.fy, camera.cy),
            (0.0, -camera.fy, camera.height - camera.cy),
        ):
            ends = None if ends is None else _clipped_line(*ends, np.array(normal), 0.0)
        if ends is not None:
            pixels = [
                (camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy)
                for p in ends
            ]
            lines.append((*pixels[0], *pixels[1]))
    return lines


def _clipped_line(
    a: Float64, b: Float64, normal: Float64, offset: float
) -> tuple[Float64, Float64] | None:
    """Return the part of the line from a to b where normal . p + offset >= 0, or None."""
    at_a, at_b = normal @ a + offset, normal @ b + offset
    if at_a < 0 and at_b < 0:
        return None
    if at_a >= 0 and at_b >= 0:
        return a, b
    middle = a + at_a / (at_a - at_b) * (b - a)
    return (a, middle) if at_a >= 0 else (middle, b)
