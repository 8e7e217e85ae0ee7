"""Models that pycolmap would read for ever, or that would fill the memory."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pycolmap
import pytest

from roigs_engine.colmap.model_files import pycolmap_model
from roigs_engine.errors import SceneError
from roigs_engine.reconstruction import worker
from tests.engine.synthetic_colmap import write_project

HUGE = 2**31
FIRST_NAME = 8 + 4 + 56 + 4  # in images.bin


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_project(tmp_path / "scene", images=None).folder / "sparse/0"


def changed(file: Path, at: int, form: str, *values: Any) -> None:
    data = bytearray(file.read_bytes())
    struct.pack_into(f"<{form}", data, at, *values)
    file.write_bytes(data)


def damage(model: Path, what: str) -> None:
    file = model / f"{what.partition(':')[0]}.bin"
    match what:
        case "points3D:track":
            changed(file, 8 + 8 + 24 + 3 + 8, "Q", HUGE)
        case "images:name":
            file.write_bytes(file.read_bytes()[:FIRST_NAME] + b"x" * 9)
        case "images:observations":
            end = file.read_bytes().index(b"\0", FIRST_NAME)
            changed(file, end + 1, "Q", HUGE)
        case "rigs:sensors":
            changed(file, 8 + 4, "I", HUGE)
        case "frames:photos":
            changed(file, 8 + 64, "I", HUGE)
        case _:
            changed(file, 0, "Q", HUGE)


DAMAGE = [
    *("points3D", "images", "cameras", "rigs", "frames"),
    *("points3D:track", "images:name", "images:observations", "rigs:sensors", "frames:photos"),
]


def test_a_whole_model_is_taken(model: Path) -> None:
    record, found = pycolmap_model(pycolmap, model)
    assert len(record.images) == found.num_reg_images() == 3


@pytest.mark.parametrize("place", ["images.bin", "frames.bin"])
@pytest.mark.parametrize("pose", [(float("nan"),) * 4, (0.0,) * 4], ids=["nan", "zero"])
def test_a_photo_without_a_pose_is_left_out(model: Path, place: str, pose: Any) -> None:
    """pycolmap would abort the process as soon as it adjusts such a photo."""
    changed(model / place, 8 + (4 if place == "images.bin" else 8), "4d", *pose)
    found = pycolmap_model(pycolmap, model)[1]
    assert found.num_reg_images() == (2 if place == "frames.bin" else 3)


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_model_is_one_line(model: Path, what: str, tmp_path: Path) -> None:
    damage(model, what)
    task = {"threads": 1, "seed": 0, "options": {}, "out": str(tmp_path / "out")}
    with pytest.raises(SceneError, match=rf"{what.partition(':')[0]}\.bin") as caught:
        worker.map_photos(pycolmap, {**task, "earlier": str(model)})
    assert caught.value.hint


@pytest.mark.parametrize(("what", "resumes"), [("", True), ("points3D:track", False)])
def test_a_damaged_snapshot_is_not_resumed(
    model: Path, what: str, resumes: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[str] = []

    def mapping(*_: Any, input_path: str, **callbacks: Any) -> dict[int, Any]:
        given.append(input_path)
        return {}

    if what:
        damage(model, what)
    monkeypatch.setattr(pycolmap, "incremental_mapping", mapping)
    task = {"threads": 1, "seed": 0, "options": {}, "out": str(tmp_path / "out")}
    places = {"database": "", "photos": "", "start": str(model)}
    assert worker.map_photos(pycolmap, {**task, **places}) == []
    assert given == [str(model) if resumes else ""]
