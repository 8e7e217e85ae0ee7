"""A model's place in the world, from the file beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import ConfigError
from roigs_engine.formats.scene_transform import (
    MOST_CAMERAS,
    MOST_TRANSFORMS,
    SceneTransform,
    document,
    read_transforms,
    some_cameras,
    transform_among,
    transform_file,
)

MATRIX = np.array([[0, -2, 0, 5], [2, 0, 0, 0], [0, 0, 2, 1], [0, 0, 0, 1.0]])


def cameras(count: int = 6, shift: float = 0.0) -> dict[str, np.ndarray]:
    ring = 2 * np.pi * np.arange(count) / count
    return {f"{k}.jpg": np.array([np.cos(a), np.sin(a) + shift, 0]) for k, a in enumerate(ring)}


def placement(shift: float = 0.0, matrix: np.ndarray = MATRIX) -> SceneTransform:
    return SceneTransform(matrix=matrix, cameras=cameras(shift=shift))


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ein Garten 庭.json"
    path.write_text(document(placement(), []), encoding="utf-8")
    (found,) = read_transforms(path)
    np.testing.assert_array_equal(found.matrix, MATRIX)
    assert found.cameras.keys() == cameras().keys()
    assert read_transforms(tmp_path / "none.json") == []


def test_it_is_that_of_a_model() -> None:
    mine, other = placement(), placement(shift=3.0)
    assert transform_among([other, mine], cameras()) is mine
    assert transform_among([other], cameras()) is None
    few = {name: cameras()[name] for name in ("1.jpg", "4.jpg")}
    assert mine.is_of(few) and not mine.is_of({}) and not mine.is_of({"x": np.zeros(3)})
    refined = {name: centre + 0.004 for name, centre in cameras().items()}
    assert mine.is_of(refined)
    assert not mine.is_of({name: 1.1 * centre for name, centre in cameras().items()})


def test_a_new_one_replaces_that_of_its_model_alone(tmp_path: Path) -> None:
    path, matrix = tmp_path / "a.json", np.eye(4)
    path.write_text(document(placement(matrix=matrix), [placement(3.0), placement()]))
    new, other = read_transforms(path)
    np.testing.assert_array_equal(new.matrix, matrix)
    assert other.is_of(cameras(shift=3.0))
    path.write_text(document(placement(), [placement(float(k)) for k in range(3, 30)]))
    assert len(read_transforms(path)) == MOST_TRANSFORMS


@pytest.mark.parametrize("count", [0, 1, MOST_CAMERAS, MOST_CAMERAS + 1, 1000])
def test_a_file_keeps_some_cameras(count: int) -> None:
    kept = some_cameras(cameras(count))
    assert min(count, MOST_CAMERAS // 2) <= len(kept) <= MOST_CAMERAS


def test_where_the_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = tmp_path / "garden"
    for name in ("sparse/0", "sparse/refined", "images"):
        (project / name).mkdir(parents=True)
        assert transform_file(project / name) == project / "roigs_placement.json"
    monkeypatch.chdir(project / "sparse")
    assert transform_file(Path()) == project / "roigs_placement.json"


GOOD: dict[str, Any] = {"matrix": MATRIX.tolist(), "cameras": {"a": [0, 0, 1]}}


def with_entry(row: int, column: int, value: object) -> dict[str, Any]:
    matrix: list[list[object]] = [list(r) for r in MATRIX.tolist()]
    matrix[row][column] = value
    return {**GOOD, "matrix": matrix}


@pytest.mark.parametrize(
    ("record", "text"),
    [
        (with_entry(0, 0, float("nan")), "NaN"),
        (with_entry(0, 3, 1e300), "too large"),
        (with_entry(0, 0, 10**400), "malformed"),
        (with_entry(0, 0, "1"), "4 x 4 numbers"),
        (with_entry(0, 0, True), "4 x 4 numbers"),
        (with_entry(2, 2, 4), "unevenly"),
        (with_entry(2, 2, -2), "mirrors"),
        (with_entry(2, 2, 0), "scale is 0"),
        (with_entry(3, 0, 1), "last row"),
        ({**GOOD, "matrix": [[1]]}, "4 x 4"),
        ({**GOOD, "matrix": None}, "4 x 4"),
        ({**GOOD, "cameras": {}}, "no cameras"),
        ({**GOOD, "cameras": []}, "malformed"),
        ({**GOOD, "cameras": {"a": [0, 1]}}, "3 numbers"),
        ({"matrix": GOOD["matrix"]}, "cameras"),
        ([], "malformed"),
        (7, "malformed"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, record: object, text: str) -> None:
    path = tmp_path / "roigs_placement.json"
    path.write_text(json.dumps({"placements": [record]}))
    with pytest.raises(ConfigError, match=text) as error:
        read_transforms(path)
    assert "roigs_placement.json" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"placements": {}}', "\x00\x00\x00\x00"])
def test_files_that_are_no_placements(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError):
        read_transforms(tmp_path / "a.json")
