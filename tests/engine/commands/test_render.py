"""`render`: the size of its pictures, and what it says of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import refused
from tests.engine.synthetic_colmap import Project

CAMERA = {"width": 96, "height": 72, "fx": 90.0, "fy": 80.0, "cx": 48.0, "cy": 30.0,
          "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}  # fmt: skip


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    points = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    colors = np.full((50, 3), 200, np.uint8)
    Gaussians.from_points(points, colors).save_ply(tmp_path / "a.ply")
    return tmp_path / "a.ply"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    cameras = [{"name": name, **CAMERA} for name in ("0001", "0002")]
    (tmp_path / "path.json").write_text(json.dumps({"cameras": cameras}), encoding="utf-8")
    return tmp_path / "path.json"


def pictures(folder: Path) -> dict[str, Image.Image]:
    return {picture.name: Image.open(picture) for picture in sorted(folder.iterdir())}


def shrunk(picture: Image.Image) -> np.ndarray:
    """A picture of half its sides."""
    return np.asarray(picture.reduce(2), dtype=float)


def test_pictures_of_a_path_have_the_size_that_was_asked_for(
    tmp_path: Path, ply: Path, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    render = ["render", str(ply), "--path", str(path), "--device", "cpu", "--out"]
    for name, options, size in (
        ("as it is", [], (96, 72)),
        ("half", ["--downscale", "2"], (48, 36)),
        ("long side", ["--max-side", "48"], (48, 36)),
        ("larger", ["--max-side", "960"], (96, 72)),
    ):
        out = tmp_path / name
        assert main([*render, str(out), *options]) == 0
        assert capsys.readouterr().out == f"2 pictures in {out}\n"
        made = pictures(out)
        assert {name: picture.size for name, picture in made.items()} == {
            "0001.png": size,
            "0002.png": size,
        }
    whole, half = (pictures(tmp_path / name)["0001.png"] for name in ("as it is", "half"))
    assert np.abs(shrunk(whole) - np.asarray(half, dtype=float)).mean() < 5  # the same view
    assert main([*render, str(tmp_path / "one"), "--name", "0002"]) == 0
    assert capsys.readouterr().out == f"1 picture in {tmp_path / 'one'}\n"


def test_the_photos_folder_has_no_meaning_for_a_path(
    tmp_path: Path, ply: Path, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    render = ["render", ply, "--path", path, "--device", "cpu", "--out", out]
    assert "--images has no meaning with --path" in refused(capsys, *render, "--images", tmp_path)
    assert not out.exists()


def test_pictures_of_a_scene(
    tmp_path: Path, project: Project, ply: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    scene = ["--scene", str(project.folder), "--images", str(project.folder / "images")]
    assert main(["render", str(ply), *scene, "--max-side", "40", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{len(project.names)} pictures in {out}\n"
    assert {max(picture.size) for picture in pictures(out).values()} == {40}
