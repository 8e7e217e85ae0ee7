"""Gains in the study's tables, near, far and on single photos, from records made by hand."""

from __future__ import annotations

import statistics
from typing import Any

import pytest

from benchmarks.study.results import Results
from benchmarks.study.rows import all_rows
from benchmarks.study.tables import Study


def by_hand(
    psnr: list[float],
    *,
    scene: str = "made",
    row: str = "joint",
    model: str = "Joint",
    **scores: float,
) -> dict[str, Any]:
    """A record of Full Scene and a model on photos a, b, c ...; a is the nearest."""
    names = "abcdefgh"[: len(psnr)]

    def scored(name: str, values: list[float]) -> dict[str, Any]:
        views = [
            {"view": view, "roi_psnr": value, "roi_ssim": 0.5, **scores}
            for view, value in zip(names, values, strict=True)
        ]
        return {
            "model": name,
            "roi_psnr": statistics.fmean(values),
            "object_psnr": None,
            "roi_ssim": 0.5,
            "image_psnr": 20.0,
            "peak_gain": None,
            "peak_view": None,
            "gaussians": 1,
            "gaussians_in_box": 1,
            "seconds": 1.0,
            "stages": {},
            "ply_bytes": 1,
            "views": views,
            "image_views": {},
            **scores,
        }

    rows = [scored("Full Scene", [20.0] * len(psnr)), scored(model, psnr)]
    box = {"roi": "box", "views": [], "left_out": [], "object_mask_from": None, "rows": rows}
    return {
        "row": row,
        "scene": scene,
        "seed": 0,
        "changes": [],
        "models": {"box": {"Full Scene": ["all"], model: ["all"]}},
        "stages": {"all": {"seconds": 1.0, "cpu_seconds": 1.0}},
        "selected": {},
        "distances": {"box": {name: float(k) for k, name in enumerate(names)}},
        "evaluation": {"test_views": list(names), "baseline": "Full Scene", "rois": [box]},
    }


def test_near_far_and_single_photos_of_a_record_of_version_0_1_0() -> None:
    results = Results([by_hand([21, 22, 20, 19, 26])])
    expected = {"near_psnr": 21.5, "far_psnr": 22.5, "near_gain": 1.5, "far_gain": 2.5}
    expected |= {"worst_gain": -1.0, "won_share": 0.6}
    for metric, value in expected.items():
        assert results.stat("made", "box", "joint", "Joint", metric).values == {0: value}
    for metric in ("roi_flip", "flip_gain"):
        assert results.stat("made", "box", "joint", "Joint", metric).values == {}


def test_flip_is_shown_if_it_was_measured_and_two_photos_have_no_near_and_far() -> None:
    for scores, shown in (({}, False), ({"roi_flip": 0.25}, True)):
        results = Results([by_hand([21, 22], **scores)])
        rows = [row for row in all_rows("draft") if row.name == "joint"]
        study = Study(
            results=results, rows=rows, tables=["II"], own="joint", head={}, figures={}
        ).markdown()
        assert ("FLIP change" in study) == shown
        line = study.splitlines()[-1]
        end = ["+0.0000", "+0.0000"] if shown else ["+0.0000"]
        cells = [cell.strip().removesuffix(" †") for cell in line.split("|")[1:-1]]
        assert cells == ["made", "box", "-", "-", "+2.00", "+1.00", "100%", *end, "1"]


def test_near_far_and_single_photos_are_over_the_tuned_baseline_too() -> None:
    """Which is missing in a scene, or measured on other photos, because one was lost in between."""
    ours = [by_hand([21, 22, 20, 19, 26], scene=scene) for scene in ("made", "other")]
    names = {"row": "full-scene-tuned", "model": "Full Scene, tuned"}
    tuned = by_hand([22, 20, 20, 20, 20], **names)
    results = Results([*ours, tuned])
    lost = Results([*ours, by_hand([22, 20, 20, 20], **names)])
    assert results.baseline == "Full Scene, tuned"
    expected = {"near_gain": 0.5, "far_gain": 2.5, "peak_gain": 6.0, "worst_gain": -1.0}
    for metric, value in {**expected, "won_share": 0.4, "ssim_gain": 0.0}.items():
        assert results.stat("made", "box", "joint", "Joint", metric).values == {0: value}
        assert results.stat("other", "box", "joint", "Joint", metric).values == {}
        assert lost.stat("made", "box", "joint", "Joint", metric).values == {}
        assert results.stat("made", "box", tuned["row"], "Full Scene, tuned", metric).values == {}
    plain = results.stat("other", "box", "joint", "Joint", "full_scene_gain").values
    assert plain == pytest.approx({0: 1.6})
    rows = [row for row in all_rows("draft") if row.name in ("joint", tuned["row"])]
    study = Study(results=results, rows=rows, tables=["I", "II"], own="joint", head={}, figures={})
    lines = study.markdown().splitlines()
    assert "to Full Scene, tuned, budget-matched" in study.markdown()
    assert [line for line in lines if "| gain | over Full Scene |" in line] == [
        *(line for line in lines if line.startswith("| method | ROI PSNR")),
        *(line for line in lines if line.startswith("| scene | box | Full Scene, tuned")),
    ]
    # One box has no tuned baseline, so there is no mean of all.
    mean = [cell.strip() for cell in lines[-1].split("|")[1:-1]]
    assert mean == ["mean", "all", *["-"] * 6, "0"]


def test_all_boxes_show_gains_of_objects_corrected_colours_detail_and_images() -> None:
    def record(row: str, model: str, **scores: float) -> dict[str, Any]:
        return by_hand([20.0, 22.0], row=row, model=model, **scores)

    tuned = record("full-scene-tuned", "Full Scene, tuned", corrected_psnr=20.0, detail_psnr=30.0)
    ours = record("joint", "Joint", corrected_psnr=21.5, detail_psnr=29.0)
    results = Results([tuned, ours])
    found = {
        metric: results.stat("made", "box", "joint", "Joint", metric).values
        for metric in ("corrected_gain", "detail_gain", "image_gain", "object_gain")
    }
    assert found == {
        "corrected_gain": {0: 1.5},
        "detail_gain": {0: -1.0},
        "image_gain": {0: 0.0},
        "object_gain": {},  # records that do not know it
    }
