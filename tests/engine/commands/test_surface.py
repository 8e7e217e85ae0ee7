"""`surface`: meshes of a run's boxes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.formats.rois import rois_document
from roigs_engine.model.roi import OrientedBox
from tests.engine.commands.command_line import refused
from tests.engine.levels.balls import cloud
from tests.engine.synthetic_colmap import write_project

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")
NAMES = [f"{number}.png" for number in range(6)]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with a ball in a box."""
    scene = write_project(tmp_path / "scene", names=NAMES).folder
    folder = tmp_path / "run"
    cloud(3000, 0, size=0.4).save_ply(folder / "result.ply")
    boxes = [OrientedBox.between("ball", [-0.5] * 3, [0.5] * 3)]
    rois = folder / "boxes.json"
    rois.write_text(rois_document(boxes))
    settings = {"scene": str(scene), "rois": str(rois), "test_every": 0}
    (folder / "manifest.json").write_text('{"config": {}}')
    (folder / "settings.json").write_text(json.dumps(settings))
    return folder


def test_a_box_gets_a_mesh_and_its_facts(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["surface", str(run), "--only", "ball", "--device", "cpu", "--faces", "2000"]
    assert main([*words, "--watertight", "--format", "stl"]) == 0
    assert "Box 'ball':" in capsys.readouterr().out
    record = json.loads((run / "rois/ball.surface.json").read_text())
    assert record["watertight"] and record["volume"] > 0
    mesh = trimesh.load(run / "rois/ball.glb", force="mesh")
    assert len(mesh.faces) == record["faces"]
    assert trimesh.load(run / "rois/ball.stl").is_watertight
    first = (run / "rois/ball.glb").read_bytes()
    assert main([*words, "--watertight"]) == 0
    assert (run / "rois/ball.glb").read_bytes() == first


def test_what_cannot_be_is_said_in_a_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "There is no box 'vase'" in refused(capsys, "surface", run, "--only", "vase")
    assert "is not a run folder" in refused(capsys, "surface", run.parent)
    (run / "settings.json").unlink()
    assert "does not say which photos" in refused(capsys, "surface", run)
