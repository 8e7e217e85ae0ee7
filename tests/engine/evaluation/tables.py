"""Rows of tables for the tests of the evaluation."""

from __future__ import annotations

import dataclasses

from roigs_engine.evaluation.scores import (
    Evaluation,
    MeasuredView,
    ModelScore,
    RoiScores,
    ViewScore,
)


def cells(line: str) -> list[str]:
    """The cells of a line of a Markdown table."""
    return [cell.strip() for cell in line.replace("\\|", "/").strip("|").split("|")]


def score(name: str, views: tuple[ViewScore, ...], **numbers: float | str | None) -> ModelScore:
    """A row with these views; numbers that are not given do not matter."""
    row = ModelScore(
        model=name,
        roi_psnr=20.0,
        object_psnr=None,
        roi_ssim=0.5,
        image_psnr=20.0,
        peak_gain=None,
        peak_view=None,
        gaussians=1,
        gaussians_in_box=1,
        seconds=1.0,
        stages={},
        ply_bytes=1,
        views=views,
        image_views={},
    )
    return dataclasses.replace(row, **numbers)


def by_hand() -> Evaluation:
    """A baseline and a model on four photos, whose numbers are made by hand."""

    def row(name: str, psnr: list[float], **numbers: float | str | None) -> ModelScore:
        views = tuple(
            ViewScore(view=f"{k}.png", roi_psnr=value, roi_ssim=0.5, distance=float(4 - k))
            for k, value in enumerate(psnr)
        )
        return score(name, views, **numbers)

    base = row("plain", [20, 20, 20, 20], near_psnr=20.0, far_psnr=20.0)
    ours = row(
        *("ours", [19.5, 21, 22, 23]),
        near_psnr=23.0,
        near_object_psnr=24.0,
        far_psnr=19.5,
        won_share=0.75,
        peak_gain=3.0,
        peak_view="3.png",
        worst_gain=-0.5,
        worst_view="0.png",
    )
    views = tuple(
        MeasuredView(
            view=f"{k}.png",
            silhouette_pixels=2000,
            object_pixels=0,
            camera_inside=False,
            small=False,
        )
        for k in range(4)
    )
    box = RoiScores(roi="box", views=views, left_out=(), object_mask_from="ours", rows=(base, ours))
    return Evaluation(test_views=tuple(v.view for v in views), baseline="plain", rois=(box,))
