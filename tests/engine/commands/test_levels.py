"""`levels`: levels of detail of a run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.formats.levels import read_ladders
from roigs_engine.formats.lock import locked
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
    (folder / "manifest.json").write_text('{"config": {}}')
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
    assert "was moved or deleted" in line and "--scene" in line
    assert main(words(run, "--scene", str(moved))) == 0


def test_another_model_is_warned_of(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One that was made anew of the same photos has another frame."""
    manifest = {"config": {}, "contents": dict.fromkeys(NAMES, ""), "model": "0" * 16}
    (run / "manifest.json").write_text(json.dumps(manifest))
    assert main(words(run)) == 0
    assert "warning: The scene has other cameras" in capsys.readouterr().err


def test_a_run_in_use_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with locked(run):
        line = refused(capsys, *words(run))
    assert "at work" in line and line.endswith(". Wait for it, or stop it.")


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


@pytest.mark.parametrize("settings", ["[1]", "5", "null", '{"scene": 5}', '{"scene": ""}'])
def test_damaged_settings_are_one_line(
    run: Path, capsys: pytest.CaptureFixture[str], settings: str
) -> None:
    (run / "settings.json").write_text(settings)
    assert "was moved or deleted" in refused(capsys, *words(run))


@pytest.mark.parametrize("sizes", [[5], 5, ["0x0"], ["-3x4"], ["9" * 30], ["axb"]])
def test_damaged_sizes_of_photos_do_not_matter(run: Path, sizes: object) -> None:
    (run / "manifest.json").write_text(json.dumps({"config": {}, "sizes": sizes}))
    settings = json.loads((run / "settings.json").read_text())
    (run / "settings.json").write_text(json.dumps(settings | {"images": sizes}))
    assert main(words(run)) == 0


@pytest.mark.parametrize(
    ("name", "value"), [("logit_opacities", -200), ("log_scales", -80), ("log_scales", 60)]
)
def test_gaussians_that_are_hardly_there(run: Path, name: str, value: float) -> None:
    model = Gaussians.load_ply(run / "rois/thing.ply")
    model.tensors()[name].fill_(value)
    model.save_ply(run / "rois/thing.ply")
    assert main(words(run)) == 0


def test_a_damaged_level_is_made_again(run: Path) -> None:
    assert main(words(run)) == 0
    level = run / "levels/1/rois/thing.ply"
    good = level.read_bytes()
    level.write_bytes(good[:-9])
    assert main(words(run)) == 0
    assert level.read_bytes() == good


def test_parts_with_other_numbers_of_sh_bands_are_drawn(run: Path, tmp_path: Path) -> None:
    thing = Gaussians.load_ply(run / "rois/thing.ply")
    replace(thing, sh=thing.sh[:, :1].clone()).save_ply(run / "rois/thing.ply")
    thing.save_ply(run / "result.ply")
    assert main(words(run)) == 0
    line = ["render", str(run / "result.ply"), "--scene", str(run.parent / "scene"), "--levels"]
    assert main([*line, "--device", "cpu", "--out", str(tmp_path / "out")]) == 0


def test_render_draws_what_a_view_needs(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(run.parent / "scene")
    result = run / "result.ply"
    parts = [Gaussians.load_ply(run / name) for name in ("background.ply", "rois/thing.ply")]
    Gaussians.concatenate(parts).save_ply(result)
    line = ["render", str(result), "--scene", scene, "--device", "cpu", "--out"]
    assert "has no levels of detail" in refused(capsys, *line, tmp_path / "a", "--levels")
    assert main(words(run)) == 0
    (run / "levels/1/rois/thing.ply").write_bytes(b"")  # not needed from near
    record = json.loads((run / "levels.json").read_text())
    for part in record["parts"]:
        path = f"levels/1/{part['levels'][0]['ply']}"
        part["levels"][1:] = [{"ply": path, "gaussians": 1, "farther": 9.0, "measured": {}}]
    (run / "levels.json").write_text(json.dumps(record))
    capsys.readouterr()
    assert main([*line, str(tmp_path / "near"), "--levels"]) == 0
    assert main([*line, str(tmp_path / "whole")]) == 0
    made = [sorted((tmp_path / folder).iterdir()) for folder in ("near", "whole")]
    assert len(made[0]) == len(NAMES)
    for pair in zip(*made, strict=True):
        near, whole = (np.asarray(Image.open(path)) for path in pair)
        np.testing.assert_allclose(near, whole, atol=1)
    capsys.readouterr()
    assert main([*line, str(tmp_path / "far"), "--levels", "--quality", "0.01"]) == 2
    assert "thing.ply is empty" in capsys.readouterr().err.splitlines()[-1]
