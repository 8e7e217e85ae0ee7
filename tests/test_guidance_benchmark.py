"""The guide's benchmark: its arithmetic, the arms' photos, and that a draw begins as it should."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.guidance.__main__ import START, averages, lines
from benchmarks.guidance.agreement import rank_correlation
from benchmarks.guidance.arms import RING, planned, shots_of, start_of, true_capture
from roigs_engine.guidance.box_map import filling_distance
from roigs_engine.guidance.known import KnownBox, known_box
from roigs_engine.model.roi import load_rois
from tests.engine.guidance.ball import BOX, CAMERA, ball_scene

DEMO = Path(__file__).resolve().parents[1] / "demo" / "scene"


@pytest.fixture(scope="module")
def known() -> KnownBox:
    return known_box(ball_scene(), BOX, look=False)


def test_averages_are_of_the_boxs_own_photos_near_and_far() -> None:
    views = {"truth/a_00.jpg": 20.0, "truth/a_01.jpg": 22.0, "truth/a_02.jpg": None}
    views |= {"truth/a_03.jpg": 30.0, "truth/b_00.jpg": 99.0}
    assert averages("a", views) == (24.0, 21.0, 30.0)


def test_the_table_has_the_guides_gain_over_the_others() -> None:
    arms = {
        arm: {"t/a_00.jpg": value, "t/a_01.jpg": value + 2}
        for arm, value in ((START, 20.0), ("guide", 23.5), ("even", 23.0), ("random", 21.0))
    }
    rows = {row[2]: row for row in lines(4, {"a": arms})}
    assert rows["guide"] == ["4", "a", "guide", "24.50", "23.50", "25.50", "+0.50", "+2.50"]
    assert rows["even"][-2:] == ["", ""] and rows[START][3] == "21.00"


def test_even_and_random_photos_stand_on_the_guides_nearest_shell(known: KnownBox) -> None:
    nearest = filling_distance(BOX, CAMERA)
    places = {tuple(centre) for centre in known.places.centres.round(9)}
    for arm in ("even", "random"):
        poses = np.array(shots_of(arm, known, 4, seed=1))
        centres = replace(known.places, poses=poses).centres
        assert len({tuple(c) for c in centres.round(9)}) == 4
        assert {tuple(c) for c in centres.round(9)} <= places
        assert np.linalg.norm(centres - BOX.centre, axis=1).max() <= RING * nearest
        assert np.array_equal(shots_of(arm, known, 4, seed=1), poses)


def test_even_photos_are_farther_apart_than_random_ones(known: KnownBox) -> None:
    def gap(arm: str, seed: int) -> float:
        poses = np.array(shots_of(arm, known, 6, seed))
        centres = replace(known.places, poses=poses).centres
        away = np.linalg.norm(centres[:, None] - centres, axis=2)
        return float(away[~np.eye(len(away), dtype=bool)].min())

    assert min(gap("even", seed) for seed in range(5)) > max(gap("random", s) for s in range(5))


def test_a_draw_begins_with_true_cameras_and_points_of_two_photos() -> None:
    capture, box = true_capture(DEMO, 400), load_rois(DEMO / "rois.json")[0]
    start = start_of(capture, box, 40, 0)
    assert len(start.images) == 40 and max(i.camera.width for i in start.images) == 400
    seen = np.bincount(np.concatenate([i.point_indices for i in start.images]))
    assert seen.min() >= 2 and len(seen) == len(start.points) < len(capture.points)
    assert {i.name for i in start.images} != {i.name for i in start_of(capture, box, 40, 1).images}


def test_planned_photos_are_camera_to_world_matrices(known: KnownBox) -> None:
    shots = planned(ball_scene(), [BOX], "even", 2, 0)
    assert list(shots) == ["ball_00.jpg", "ball_01.jpg"]
    for matrix in shots.values():
        turn = np.array(matrix)[:3, :3]
        assert turn.T @ turn == pytest.approx(np.eye(3), abs=1e-9)
        forward = BOX.centre - np.array(matrix)[:3, 3]
        assert turn[:, 2] == pytest.approx(forward / np.linalg.norm(forward))


def test_rank_correlation_is_of_the_order_alone() -> None:
    a = np.array([1.0, 2.0, 3.0, 10.0])
    assert rank_correlation(a, np.exp(a)) == pytest.approx(1)
    assert rank_correlation(a, -(a**3)) == pytest.approx(-1)
