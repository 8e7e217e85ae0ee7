"""One rule for matrices: a rotation and a translation, of a box or of a camera."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import ConfigError, EngineError, RoiError
from roigs_engine.formats.rois import RoiRecord, read_rois, roi_record
from roigs_engine.formats.transforms import is_mirrored, rigid_flaw
from roigs_engine.model.roi import roi_from_dict
from roigs_engine.rasterize.camera_path import load_camera_path

HALF = np.sqrt(0.5)
TURNED = np.array([[HALF, -HALF, 0, 3], [HALF, HALF, 0, -2], [0, 0, 1, 1], [0, 0, 0, 1.0]])
SHEARED = TURNED @ np.array([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
WRONG = {
    "transposed": (TURNED.T, "is it transposed"),
    "a row of zeros": (np.vstack([TURNED[:3], np.zeros(4)]), "last row is 0, 0, 0, 0"),
    "a perspective": (np.vstack([TURNED[:3], [0, 0, 0.1, 1]]), "last row"),
    "scaled": (TURNED @ np.diag([2.0, 2, 2, 1]), "scales or shears"),
    "one axis scaled": (TURNED @ np.diag([1.0, 1.01, 1, 1]), "scales or shears"),
    "sheared": (SHEARED, "scales or shears"),
    "flat": (TURNED @ np.diag([1.0, 1, 0, 1]), "scales or shears"),
}


def box(matrix: Any) -> dict[str, Any]:
    return {"name": "a", "world_to_box": np.asarray(matrix).tolist(), "half_extents": [1, 2, 3]}


def camera_file(folder: Path, matrix: Any) -> Path:
    record = {"name": "a", "width": 8, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0}
    record["world_to_camera"] = np.asarray(matrix).tolist()
    path = folder / "path.json"
    path.write_text(json.dumps({"cameras": [record]}), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", WRONG)
def test_boxes_and_cameras_refuse_the_same_matrices(name: str, tmp_path: Path) -> None:
    matrix, text = WRONG[name]
    with pytest.raises(RoiError, match=text):
        roi_record(box(matrix))
    with pytest.raises(RoiError, match=text):
        RoiRecord(name="a", world_to_box=matrix, half_extents=np.ones(3))
    with pytest.raises(ConfigError, match=text):
        load_camera_path(camera_file(tmp_path, matrix))


def test_matrices_of_few_digits_or_32_bits_pass(tmp_path: Path) -> None:
    for matrix in (TURNED.round(4), TURNED.astype(np.float32)):
        assert not rigid_flaw(np.asarray(matrix, dtype=float))
        np.testing.assert_array_equal(roi_record(box(matrix)).world_to_box, matrix)
        load_camera_path(camera_file(tmp_path, matrix))


def test_a_mirrored_box_is_the_same_volume_but_a_mirrored_camera_is_refused(
    tmp_path: Path,
) -> None:
    points = np.random.default_rng(0).uniform(-6, 6, (500, 3))
    plain = roi_from_dict(box(TURNED))
    for axis in range(3):
        sign = np.ones(4)
        sign[axis] = -1
        mirrored = np.diag(sign) @ TURNED
        same = roi_from_dict(box(mirrored))
        assert not is_mirrored(same.world_to_box)
        np.testing.assert_array_equal(same.contains(points), plain.contains(points))
        assert {tuple(c) for c in same.corners().round(9)} == {
            tuple(c) for c in plain.corners().round(9)
        }
        with pytest.raises(ConfigError, match="mirrors"):
            load_camera_path(camera_file(tmp_path, mirrored))


def test_a_box_of_two_forms_is_refused_and_the_file_named(tmp_path: Path) -> None:
    path = tmp_path / "rois.json"
    both = {**box(TURNED), "min": [0, 0, 0], "max": [1, 1, 1]}
    path.write_text(json.dumps([both]), encoding="utf-8")
    with pytest.raises(RoiError, match=r"rois\.json.*both"):
        read_rois(path)


@pytest.mark.parametrize("number", [1e15, -1e300, float("nan"), float("inf")])
def test_numbers_too_large_are_one_line_without_a_warning(number: float) -> None:
    matrix = TURNED.copy()
    matrix[0] = number
    with pytest.raises(EngineError, match="NaN, Inf or too large") as caught:
        roi_record(box(matrix))
    assert caught.value.hint
