"""`levels`: levels of detail of a run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.formats.levels import read_ladders
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import refused
from tests.engine.synthetic_colmap import write_project

NAMES = ["a.png", "b.png", "c.png", "d.png"]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with a box, and the scene that it knows."""
    scene = write_project(tmp_path / "scene", names=NAMES).folder
    folder = tmp_path / "run"
    rng = np.random.default_rng(1)
    for name, size in (("rois/thing.ply", 0.3), ("background.ply", 0.6)):
        places = rng.uniform(-size, size, (400, 3))
        model = Gaussians.from_points(places, rng.integers(0, 256, places.shape).astype(np.uint8))
        model.save_ply(folder / name)
    (folder / "manifest.json").write_text("{}")
    (folder / "settings.json").write_text(json.dumps({"scene": str(scene)}))
    return folder


def words(run: Path, *more: str) -> list[str]:
    return ["levels", str(run), "--levels", "2", "--steps", "2", "--device", "cpu", *more]


def test_the_scene_of_the_run_is_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(run)) == 0
    said = capsys.readouterr().out
    assert "| thing | 400 |" in said and "| surroundings | 400 |" in said
    assert set(read_ladders(run)) == {"", "thing"}
    assert len(Gaussians.load_ply(run / "levels/1/rois/thing.ply")) == 200


def test_a_moved_scene_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = (run.parent / "scene").rename(run.parent / "moved")
    line = refused(capsys, *words(run))
    assert "is not where it was" in line and "--scene" in line
    assert main(words(run, "--scene", str(moved))) == 0


def test_bad_input_is_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "is not a run folder" in refused(capsys, *words(run.parent))
    (run / "background.ply").rename(run / "kept")
    assert "has no result" in refused(capsys, *words(run))
    (run / "background.ply").write_bytes(b"ply\n")
    assert "background.ply" in refused(capsys, *words(run))
    (run / "kept").replace(run / "background.ply")
    (run / "levels.json").write_text("{")  # replaced
    (run / "levels").mkdir()
    (run / "levels/made.json").write_text("[]")
    assert main(words(run)) == 0
    capsys.readouterr()
    (run / "levels/1").rename(run.parent / "elsewhere")
    (run / "levels/1").symlink_to(run.parent / "elsewhere")
    assert "link" in refused(capsys, *words(run))
