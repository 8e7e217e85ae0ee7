"""`rois.json` and the rule for names, which both programs follow."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import RoiError
from roigs_engine.formats.names import first_taken, is_file_name, safe_name
from roigs_engine.formats.rois import (
    RoiRecord,
    check_roi_name,
    read_rois,
    roi_record,
    rois_document,
)

TURN = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]]


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "Wörter 東京.json"
    boxes = [
        RoiRecord.between("vase", [-1, -2, -3], [1, 2, 4]),
        roi_record({"name": "図 2", "world_to_box": TURN, "half_extents": [1, 2, 0.5]}),
    ]
    path.write_text(rois_document(boxes), encoding="utf-8")
    found = read_rois(path)
    assert [box.name for box in found] == ["vase", "図 2"]
    for box, wanted in zip(found, boxes, strict=True):
        np.testing.assert_array_equal(box.world_to_box, wanted.world_to_box)
        np.testing.assert_array_equal(box.half_extents, wanted.half_extents)
    np.testing.assert_allclose(found[0].half_extents, [1, 2, 3.5])
    np.testing.assert_allclose(found[0].world_to_box[:3, 3], [0, 0, -0.5])


@pytest.mark.parametrize(
    "name",
    [
        "",
        " a",
        "a ",
        "a.",
        "a/b",
        "a\\b",
        "c:",
        "NUL",
        "com1.x",
        "aux .jpg",
        "CONIN$",
        "lpt\u00b2",
        "a\0",
        "\ud800",
        "x" * 101,
    ],
)
def test_names_that_cannot_name_files_on_every_system(name: str) -> None:
    assert not is_file_name(name)
    with pytest.raises(RoiError, match="cannot name a file") as caught:
        check_roi_name(name)
    assert caught.value.hint


@pytest.mark.parametrize("name", ["vase.compressed", "Vase.SURFACE"])
def test_names_that_end_as_files_of_other_boxes(name: str) -> None:
    """`vase.compressed.ply` would be read as a compressed PLY, and written for the box `vase`."""
    with pytest.raises(RoiError, match="cannot name a box") as caught:
        check_roi_name(name)
    assert caught.value.hint


@pytest.mark.parametrize("name", ["vase", "図 2", "a.b", "com10", "x" * 100])
def test_names_that_can(name: str) -> None:
    assert check_roi_name(name) == name
    assert is_file_name(safe_name(name))


@pytest.mark.parametrize(
    "name",
    [
        *("NUL", "con.png", "Aux .jpg", "com\u00b9", "CONOUT$.txt", "a. .", ".. "),
        *("\u56fe" * 90, "\U00020000" * 90, "0" * 81, "0" * 90, "x." * 44),
    ],
    ids=range(12),
)
def test_names_of_cameras_become_names_of_files_of_every_system(name: str) -> None:
    safe = safe_name(name)
    assert is_file_name(safe) and safe_name(safe) == safe
    assert len(f".{safe}.png.4194304-0123abcd.part".encode()) < 255


def test_names_that_share_a_file() -> None:
    assert first_taken(["a", "b", "A"]) == "A"
    assert first_taken(["Stra\u00dfe", "STRASSE"]) == "STRASSE"
    assert first_taken(["a", "b"]) is None


@pytest.mark.parametrize(
    ("record", "text"),
    [
        ({"name": "a", "min": [0, 0, 0], "max": [1, 1, 0]}, "is empty: its sides are 1 x 1 x 0"),
        ({"name": "a", "min": [0, 0, 0], "max": [1, 1, float("nan")]}, "NaN, Inf or too large"),
        ({"name": "a", "min": [0, 0], "max": [1, 1, 1]}, "must be 3 numbers"),
        ({"name": "a", "world_to_box": np.diag([2.0, 1, 1, 1]).tolist(), "half_extents": [1, 1, 1]},
         "not a rotation and a translation"),
        ({"min": [0, 0, 0]}, "must be an object"),
        ([], "must be an object"),
    ],
)  # fmt: skip
def test_one_line_says_what_is_wrong(record: object, text: str, tmp_path: Path) -> None:
    with pytest.raises(RoiError, match=text):
        roi_record(record)
    path = tmp_path / "rois.json"
    path.write_text(json.dumps([record]), encoding="utf-8")
    with pytest.raises(RoiError, match=text):
        read_rois(path)


@pytest.mark.parametrize("text", ["", "{}", '{"rois": []}', "3", "[" * 100_000])
def test_files_without_boxes(text: str, tmp_path: Path) -> None:
    path = tmp_path / "rois.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RoiError, match=r"rois\.json"):
        read_rois(path)
    with pytest.raises(RoiError, match="Cannot read"):
        read_rois(tmp_path / "none.json")


def test_true_is_no_number() -> None:
    with pytest.raises(RoiError, match="must be 3 numbers"):
        roi_record({"name": "a", "min": [True, 0, 0], "max": [2, 2, 2]})
