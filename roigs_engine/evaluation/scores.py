"""The scores of an evaluation as immutable values, with conversion to and from JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

FULL_SCENE, FULL_SCENE_TUNED = "Full Scene", "Full Scene, tuned"
"""Names of the baselines. Gains are relative to the tuned one, if there is one."""
MIN_SILHOUETTE = 1024  # pixels; views with fewer silhouette pixels are skipped for the box
MIN_OBJECT = 256  # pixels; views with fewer object pixels are skipped in the object column


@dataclass(frozen=True, kw_only=True)
class ViewScore:
    """One model on one test view, inside one box's masks; PSNR in dB.

    Attributes:
        roi_psnr, roi_ssim: on the silhouette.
        object_psnr: None if the view has fewer than `MIN_OBJECT` object pixels.
        roi_flip: FLIP error on the silhouette; None without the package.
        distance: of the camera from the box's centre, in diagonals of the box.
        mask_psnr: on the pixels of the photo's mask of the box's object; None without such a mask,
            or if it has fewer than `MIN_OBJECT` pixels.
        corrected_psnr: on the silhouette, after the colours' correction (`metrics`).
        detail_psnr: on the silhouette, after subtracting a blur (`metrics`).
    """

    view: str
    roi_psnr: float
    roi_ssim: float
    object_psnr: float | None = None
    roi_flip: float | None = None
    distance: float | None = None
    mask_psnr: float | None = None
    corrected_psnr: float | None = None
    detail_psnr: float | None = None


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of a model over another one on single photos, in ROI PSNR, dB; None without photos.

    Attributes:
        peak_gain, peak_view: the largest gain, and its photo.
        worst_gain, worst_view: the least gain, and its photo.
        won_share: share of the photos with a gain above 0.
    """

    peak_gain: float | None = None
    peak_view: str | None = None
    worst_gain: float | None = None
    worst_view: str | None = None
    won_share: float | None = None

    @classmethod
    def of(cls, gains: Mapping[str, float]) -> Gains:
        """Compute from the gain on each photo. Of equal gains, the first photo is named."""
        if not gains:
            return Gains()
        peak, worst = max(gains, key=lambda k: gains[k]), min(gains, key=lambda k: gains[k])
        return Gains(
            peak_gain=gains[peak],
            peak_view=peak,
            worst_gain=gains[worst],
            worst_view=worst,
            won_share=sum(gain > 0 for gain in gains.values()) / len(gains),
        )


@dataclass(frozen=True, kw_only=True)
class ModelScore(Gains):
    """One row of a table, with its gains over the baseline; None stands for no number.

    Attributes:
        roi_psnr, object_psnr, roi_ssim, roi_flip: means over the box's views; PSNR in dB.
        mask_psnr, corrected_psnr, detail_psnr: means over the box's views, see `ViewScore`.
        near_psnr, far_psnr: means of ROI PSNR over the near and the far third of the views, dB.
        near_object_psnr: mean of object PSNR over the near third, dB.
        image_psnr: mean over all test views, dB.
        seconds, stages: training time, in all and of each stage.
        ply_bytes: size of the model's PLY.
        made_for: name of the target for which it is drawn.
        views: scores of each view of the box.
        image_views: test view -> PSNR over the whole image, dB.
    """

    model: str
    roi_psnr: float | None
    object_psnr: float | None
    roi_ssim: float | None
    image_psnr: float
    gaussians: int
    gaussians_in_box: int
    seconds: float
    stages: dict[str, float]
    ply_bytes: int
    views: tuple[ViewScore, ...]
    image_views: dict[str, float]
    roi_flip: float | None = None
    mask_psnr: float | None = None
    corrected_psnr: float | None = None
    detail_psnr: float | None = None
    near_psnr: float | None = None
    far_psnr: float | None = None
    near_object_psnr: float | None = None
    made_for: str | None = None


@dataclass(frozen=True, kw_only=True)
class MeasuredView:
    """A test view that counts for a box.

    Attributes:
        silhouette_pixels, object_pixels: sizes of the two masks.
        camera_inside: the camera is inside the box, so the silhouette is the whole image.
        small: fewer than `MIN_SILHOUETTE` pixels, used because no view has more.
    """

    view: str
    silhouette_pixels: int
    object_pixels: int
    camera_inside: bool
    small: bool


@dataclass(frozen=True, kw_only=True)
class RoiScores:
    """The table of one box.

    Attributes:
        views: the test views that count.
        left_out: names of the other test views.
        object_mask_from: name of the model whose depth defines the object's mask; None without
            scores.
    """

    roi: str
    views: tuple[MeasuredView, ...]
    left_out: tuple[str, ...]
    object_mask_from: str | None
    rows: tuple[ModelScore, ...]


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """All tables.

    Attributes:
        test_views: names of the measured photos.
        baseline: name of the model for computing gains.
        photos: kind of the measured photos, `test` or `validation`.
        masked: number of photos with a mask; pixels that it ignores are not measured.
    """

    test_views: tuple[str, ...]
    baseline: str
    rois: tuple[RoiScores, ...]
    photos: str = "test"
    masked: int = 0

    def roi(self, name: str) -> RoiScores:
        """Return the table of a box; KeyError if there is none."""
        return {scores.roi: scores for scores in self.rois}[name]

    def to_dict(self) -> dict[str, Any]:
        """Return a record ready for JSON."""
        record: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self)))
        if not self.masked:
            del record["masked"]
        rows = [row for scores in record["rois"] for row in scores["rows"]]
        if all(row["mask_psnr"] is None for row in rows):
            for part in (*rows, *(view for row in rows for view in row["views"])):
                del part["mask_psnr"]
        return record

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Evaluation:
        """Invert `to_dict`."""
        rois = []
        for scores in record["rois"]:
            rows = tuple(
                ModelScore(**{**row, "views": tuple(ViewScore(**view) for view in row["views"])})
                for row in scores["rows"]
            )
            views = tuple(MeasuredView(**view) for view in scores["views"])
            left_out = tuple(scores["left_out"])
            rois.append(RoiScores(**{**scores, "rows": rows, "views": views, "left_out": left_out}))
        test_views = tuple(record["test_views"])
        return cls(**{**record, "rois": tuple(rois), "test_views": test_views})


FEW_VIEWS = 3  # with fewer test photos, scores are uncertain, and have no near and far third


def near_and_far(distances: Mapping[str, float]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the third of the photos with the nearest cameras, and with the farthest; near first.

    A third of N photos is N / 3, rounded: 1 of 3 or 4 photos, 2 of 5 to 7, 3 of 8. No photo is
    in both. Both are empty for fewer than `FEW_VIEWS` photos. Equal distances are sorted by name.

    Args:
        distances: photo -> distance of its camera from the box.
    """
    if len(distances) < FEW_VIEWS:
        return (), ()
    order = sorted(distances, key=lambda name: (distances[name], name))
    third = (len(order) + 1) // 3
    return tuple(order[:third]), tuple(order[-third:])


def mean(values: Sequence[float]) -> float | None:
    """Return the mean; None without values."""
    return float(np.mean(values)) if values else None
