"""`levels`, killed at any moment and given again, makes the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.engine.killing import Moment, engine
from tests.engine.levels.balls import cloud
from tests.engine.synthetic_colmap import camera, write_project

QUICK = (
    "level 2 of surroundings: half of background",
    "level 1 of thing: before thing.ply has its name",
)
SLOW = (
    "level 1 of surroundings: step",
    "level 1 of thing: after thing.ply has its name",
    "level 2 of thing: half of made",
    "level 2 of thing: before levels.json has its name",
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose levels nobody hindered."""
    folder = tmp_path_factory.mktemp("runs")
    lens = camera(width=192, height=144, params=[250.0, 250.0, 96.0, 72.0])
    names = [f"{k}.png" for k in range(6)]
    scene = write_project(folder / "scene", names=names, cameras=[lens]).folder
    run = make_run(folder / "whole", scene)
    ended = engine(words(run))
    assert ended.status == 0, ended.errors
    assert all(any(moment == name for name in ended.moments) for moment in (*QUICK, *SLOW))
    assert (run / "levels/2/rois/thing.ply").is_file()
    return run


def make_run(folder: Path, scene: Path) -> Path:
    cloud(500, 0).save_ply(folder / "rois/thing.ply")
    cloud(500, 1, size=0.8, shift=0.5).save_ply(folder / "background.ply")
    (folder / "manifest.json").write_text('{"config": {}}')
    (folder / "settings.json").write_text(json.dumps({"scene": str(scene)}))
    return folder


def words(run: Path) -> list[object]:
    return ["levels", run, "--levels", "3", "--steps", "6", "--device", "cpu", "--threads", "1"]


def contents(run: Path) -> dict[str, bytes]:
    """The files of `levels`."""
    files = [run / "levels.json", *sorted((run / "levels").rglob("*"))]
    return {str(p.relative_to(run)): p.read_bytes() for p in files if p.is_file()}


@pytest.mark.parametrize(
    "place", [*QUICK, *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW)]
)
def test_it_makes_the_same_bytes(whole: Path, tmp_path: Path, place: str) -> None:
    run = make_run(tmp_path / "run", whole.parent / "scene")
    assert engine(words(run), Moment(f"^{place}$", 1)).status == -9
    assert not (run / "levels.json").exists()
    ended = engine(words(run))
    assert ended.status == 0, ended.errors
    assert contents(run) == contents(whole) and not list(run.rglob("*.part"))
