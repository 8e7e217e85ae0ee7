"""Rows of tables for the tests of the evaluation."""

from __future__ import annotations

import dataclasses

from roigs_engine.evaluation.scores import ModelScore, ViewScore


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
