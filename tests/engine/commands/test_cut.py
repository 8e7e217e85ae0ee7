"""`cut`: objects out of their boxes along masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import camera, write_project

NAMES = ["sub/a.png", "b.png", "c.png", "d.png"]
SECOND = "other=0.5,-0.5,-0.5,1.5,0.5,0.5"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A project with distorted cameras and a model; masks show the upper half of the box."""
    lens = camera("SIMPLE_RADIAL", params=[100.0, 48.0, 36.0, 0.08])
    project = write_project(tmp_path / "scene", names=NAMES, cameras=[lens])
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.48, 0.48, (600, 3)) * [1, 0.9, 1]
    places[np.abs(places[:, 1]) < 0.1, 1] = 0.3
    places = np.concatenate([places, [[0.9, 0.1, 0.1], [3.0, 0.0, 0.0]]])
    model = Gaussians.from_points(places, rng.integers(0, 256, places.shape).astype(np.uint8))
    model.log_scales.fill_(-4.0)
    model.save_ply(tmp_path / "model.ply")
    for k in (0, 2, 3):
        pose = project.poses[k]
        local = places[:, :] @ pose[:3, :3].T + pose[:3, 3]
        above = places[:600, 1] < 0  # y points down
        mask = np.zeros((72, 96), np.uint8)
        pixels = np.array([lens.img_from_cam(p) for p in local[:600][above]])
        for x, y in pixels.round().astype(int):
            mask[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3] = 255
        pixels = np.array([lens.img_from_cam(p) for p in local[:600][~above]])
        for x, y in pixels.round().astype(int):
            mask[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = 0
        path = project.folder / "masks/thing" / f"{NAMES[k]}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask).save(path)
    return project.folder


def words(scene: Path, out: Path, *more: str) -> list[str]:
    model = str(scene.parent / "model.ply")
    line = ["cut", str(scene), "--roi", BOX, "--model", model, "--device", "cpu"]
    return [*line, "--out", str(out), *more]


def test_the_upper_half_is_cut_out(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(words(scene, out, "--roi", SECOND)) == 0
    said = capsys.readouterr().err
    assert "by masks on 3 photos" in said and "Box 'other' has no masks: it stays whole." in said
    whole = read_ply(tmp_path / "model.ply")["means"]
    names = ("rois/thing.ply", "rois/other.ply", "background.ply")
    parts = [read_ply(out / name)["means"] for name in names]
    assert sum(map(len, parts)) == len(whole)
    thing, other, rest = parts
    assert len(other) == 1 and abs(other[0, 0] - 0.9) < 1e-5
    above = whole[(np.abs(whole) < 0.5).all(axis=1) & (whole[:, 1] < 0)]
    found = {tuple(place) for place in thing.round(4)}
    wanted = {tuple(place) for place in above.round(4)}
    assert len(found & wanted) > 0.9 * len(wanted) and len(found - wanted) < 0.1 * len(wanted)
    assert len(rest) >= 2


def test_what_cannot_be_cut(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    line = refused(capsys, *words(scene, out, "--masks", str(tmp_path)))
    assert "has no folder of masks for a box (thing)" in line
    (tmp_path / "m/thing").mkdir(parents=True)
    assert main(words(scene, out, "--masks", str(tmp_path / "m"))) == 2
    (line,) = [s for s in capsys.readouterr().err.splitlines() if s.startswith("error: ")]
    assert "No mask in" in line and "shows an object" in line
    model = scene.parent / "model.ply"
    (out / "rois").mkdir(parents=True)
    model.rename(out / "background.ply")
    line = refused(capsys, *words(scene, out)[:4], "--model", out / "background.ply", "--out", out)
    assert "is an input of this command" in line
