"""`suggest` from end to end: the list, the page, the pictures; bad input ends in a line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from roigs_engine import Suggest, suggest
from roigs_engine.errors import EngineError
from roigs_engine.rasterize.camera_path import load_camera_path
from tests.engine.synthetic_colmap import write_project

BOX = "pot=-0.5,-0.5,-0.5,0.5,0.5,0.5"
NAMES = tuple(f"{number:02d} <i>&.png" for number in range(12))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(300, 3))
    ball *= 0.4 / np.linalg.norm(ball, axis=1)[:, None]
    ground = np.column_stack([rng.uniform(-5, 5, 600), np.full(600, 0.45), rng.uniform(-5, 5, 600)])
    folder = tmp_path_factory.mktemp("project")
    write_project(folder, names=NAMES, points=np.concatenate([ball, ground]), dots=True)
    return folder


@pytest.fixture(scope="module")
def made(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("next")
    suggest(Suggest(scene=project, roi=(BOX,), count=3, out=out))
    return out


def test_the_list_is_a_camera_path_with_gains_and_words(made: Path) -> None:
    record = json.loads((made / "suggestions.json").read_text())
    assert record["metres_per_unit"] is None
    assert [box["name"] for box in record["boxes"]] == ["pot"]
    cameras = record["cameras"]
    assert [camera["number"] for camera in cameras] == [1, 2, 3]
    assert cameras[0]["gain"] >= cameras[1]["gain"] >= cameras[2]["gain"] > 0
    known = [record["boxes"][0]["known"], *(camera["known"] for camera in cameras)]
    assert known == sorted(known) and known[-1] > known[0]
    for camera in cameras:
        assert (made / camera["picture"]).is_file()
        assert camera["near"] in NAMES and camera["near"] in camera["words"]
    path = load_camera_path(made / "suggestions.json")
    assert [name for name, _, _ in path] == [camera["name"] for camera in cameras]
    for (_, _, pose), camera in zip(path, cameras, strict=True):
        distance = np.linalg.norm(pose[:3, :3].T @ pose[:3, 3])
        assert camera["distance"] == pytest.approx(distance)


def test_names_are_text_alone_on_the_page(made: Path) -> None:
    page = (made / "suggestions.html").read_text()
    assert "&lt;i&gt;&amp;" in page and "<i>" not in page
    assert page.count("data:image/jpeg;base64,") == 3
    assert not re.search(r"""(src|href)=["']?(https?:|//|file:)""", page)
    assert "default-src 'none'" in page


def test_metres_where_the_scene_was_placed(project: Path, tmp_path: Path) -> None:
    from roigs_engine.colmap.project import load_colmap

    centres = {i.name: i.centre.tolist() for i in load_colmap(project, pixels=False).images}
    placement = project / "roigs_placement.json"
    matrix = np.diag([0.5, 0.5, 0.5, 1]).tolist()
    placement.write_text(json.dumps({"placements": [{"matrix": matrix, "cameras": centres}]}))
    try:
        done = suggest(Suggest(scene=project, roi=(BOX,), count=1, no_look=True, out=tmp_path))
    finally:
        placement.unlink()
    assert done.record["metres_per_unit"] == pytest.approx(0.5)
    shot = done.record["cameras"][0]
    assert re.match(rf"{shot['distance'] / 2:.1f} m from|\d+ cm from", shot["words"])


def test_bad_input_is_one_line(project: Path, tmp_path: Path) -> None:
    with pytest.raises(EngineError, match="contains no sparse point"):
        suggest(Suggest(scene=project, roi=("x=90,90,90,91,91,91",), out=tmp_path))
    with pytest.raises(EngineError, match="There is no box"):
        suggest(Suggest(scene=project, out=tmp_path))
    with pytest.raises(EngineError):
        suggest(Suggest(scene=project, roi=(BOX,), model=tmp_path / "no.ply", out=tmp_path))
