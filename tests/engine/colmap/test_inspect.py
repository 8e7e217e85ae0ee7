"""The report of `inspect` about a scene and its boxes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.colmap.inspect import format_inspection, inspect_scene
from roigs_engine.colmap.project import load_colmap
from roigs_engine.model.roi import OrientedBox
from tests.engine.synthetic_colmap import camera, write_project


def test_figures_of_a_scene_and_its_boxes(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [0.8, 0.0, 0.0], [-0.8, 0.2, 0.1]])
    names = [f"{index}.png" for index in range(8)]
    cameras = [camera(), camera(width=60, height=90, params=[100.0, 100.0, 30.0, 45.0])]
    write_project(tmp_path, names=names, cameras=cameras, points=points)
    (tmp_path / "images/7.png").unlink()
    scene = load_colmap(tmp_path)
    boxes = [
        OrientedBox.between("middle", [-0.2] * 3, [0.2] * 3),
        OrientedBox.between("far", [5, 5, 5], [6, 6, 6]),
        OrientedBox.between("all", [-9] * 3, [9] * 3),
    ]
    report = inspect_scene(scene, boxes)
    assert json.loads(json.dumps(report)) == report
    assert (report["photos"], report["cameras"], report["points"]) == (7, 2, 4)
    assert (report["smallest"], report["largest"]) == ([60, 90], [96, 72])
    assert report["skipped"] == {"missing on disk": {"count": 1, "first": ["7.png"]}}
    assert report["extent"] == pytest.approx(scene.extent())
    middle, far, everything = report["rois"]
    assert (middle["points"], middle["photos"]) == (2, 7)
    distance = float(np.hypot(4, 1))
    assert middle["nearest"] == pytest.approx(distance) == middle["farthest"]
    assert 0 < middle["median_area"] < 0.3 and middle["cameras_inside"] == 0
    assert (far["points"], far["photos"], far["median_area"]) == (0, 0, 0.0)
    assert (everything["median_area"], everything["cameras_inside"]) == (1.0, 7)
    text = format_inspection(report)
    for part in ("7, 2 cameras", "60 x 90 to 96 x 72", "1 missing on disk: 7.png", "'middle'"):
        assert part in text


def test_without_tracks_silhouettes_decide(tmp_path: Path) -> None:
    write_project(tmp_path, tracks=False)
    scene = load_colmap(tmp_path)
    box = OrientedBox.between("box", [-0.3] * 3, [0.3] * 3)
    report = inspect_scene(scene, [box])
    assert not report["has_tracks"] and report["rois"][0]["photos"] == 3
    assert "does not store" in format_inspection(report)


def test_an_empty_scene(tmp_path: Path) -> None:
    write_project(tmp_path)
    scene = replace(load_colmap(tmp_path), images=(), points=np.empty((0, 3)))
    report = inspect_scene(scene)
    assert report["photos"] == 0 and report["smallest"] == [0, 0]
    assert format_inspection(report)
