"""`convert --plain`: results of a run for viewers that draw without anti-aliasing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.app.run_scene import cameras_of_result
from roigs_engine.cli import main
from roigs_engine.formats.splat_ply import target_of
from roigs_engine.formats.targets import PLAIN, VIEWERS
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.rasterize.view import render_view
from tests.engine.commands.command_line import refused
from tests.engine.synthetic_colmap import write_project

WARNING = "too thick"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with results that are anti-aliased, and the scene that it knows."""
    names = [f"{letter}.png" for letter in "abcd"]
    scene = write_project(tmp_path / "scene", names=names).folder
    folder = tmp_path / "run"
    random = np.random.default_rng(1)
    places = random.uniform(-0.4, 0.4, (400, 3))
    model = Gaussians.from_points(places, random.integers(0, 256, places.shape).astype(np.uint8))
    fine = model.log_scales.new_full(model.log_scales.shape, np.log(0.01))
    model = replace(model, log_scales=fine, logit_opacities=fine[:, 0] + 5, target=VIEWERS)
    for name in ("result.ply", "rois/thing.ply"):
        model.save_ply(folder / name)
    (folder / "manifest.json").write_text("{}")
    (folder / "settings.json").write_text(json.dumps({"scene": str(scene)}))
    return folder


def error(run: Path, model: Gaussians) -> float:
    """Of a model's pictures from the run's photos, against those of its result."""
    scene = cameras_of_result(run / "result.ply")
    assert scene is not None
    result = Gaussians.load_ply(run / "result.ply")
    differences = []
    for image in scene.images:
        pictures = [
            render_view(m, image.camera, image.world_to_camera).image for m in (model, result)
        ]
        assert pictures[1].max() > 0.05
        differences.append((pictures[0] - pictures[1]).square().mean())
    return float(torch.stack(differences).mean().sqrt())


@pytest.mark.parametrize("name", ["result.ply", "rois/thing.ply"])
def test_opacities_become_what_the_photos_show(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    out, places = tmp_path / "out.ply", tmp_path / "list.json"
    model = {"ply": str(run / name), "matrix": np.eye(4).tolist()}
    places.write_text(json.dumps({"models": [model]}))
    kept = replace(Gaussians.load_ply(run / name), target=PLAIN)
    for source in (run / name, places):
        assert main(["convert", str(source), str(out), "--plain"]) == 0
        assert not target_of(out).antialiased
        assert error(run, Gaussians.load_ply(out)) < 0.3 * error(run, kept)
    assert WARNING not in capsys.readouterr().err


def test_formats_that_cannot_say_it_are_always_plain(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    splat, back = tmp_path / "out.splat", tmp_path / "back.ply"
    assert main(["convert", str(run / "result.ply"), str(splat)]) == 0
    assert main(["convert", str(splat), str(back)]) == 0
    kept = replace(Gaussians.load_ply(run / "result.ply"), target=PLAIN)
    assert error(run, Gaussians.load_ply(back)) < 0.5 * error(run, kept)
    assert WARNING not in capsys.readouterr().err


def test_without_the_photos_it_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mark would be gone, and nothing made up for it."""
    scene = json.loads((run / "settings.json").read_text())["scene"]
    (run / "settings.json").unlink()
    out = tmp_path / "out.ply"
    assert "--scene" in refused(capsys, "convert", run / "result.ply", out, "--plain")
    assert not out.exists()
    kept = replace(Gaussians.load_ply(run / "result.ply"), target=PLAIN)
    (run / "settings.json").write_text(json.dumps({"scene": scene}))
    copied = tmp_path / "other.ply"
    copied.write_bytes((run / "result.ply").read_bytes())
    for source in (run / "result.ply", copied):
        assert main(["convert", str(source), str(out), "--plain", "--scene", scene]) == 0
        assert error(run, Gaussians.load_ply(out)) < 0.3 * error(run, kept)


def test_without_the_photos_other_formats_warn_once(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "settings.json").unlink()
    splat, back = tmp_path / "out.splat", tmp_path / "back.ply"
    assert main(["convert", str(run / "result.ply"), str(splat)]) == 0
    assert capsys.readouterr().err.count(WARNING) == 1
    assert main(["convert", str(splat), str(back)]) == 0
    made, result = (Gaussians.load_ply(path) for path in (back, run / "result.ply"))
    torch.testing.assert_close(
        made.logit_opacities.sigmoid(), result.logit_opacities.sigmoid(), atol=0.01, rtol=0
    )


def test_a_model_that_is_plain_stays_as_it_is(run: Path, tmp_path: Path) -> None:
    model = replace(Gaussians.load_ply(run / "result.ply"), target=PLAIN)
    model.save_ply(run / "result.ply")
    out = tmp_path / "out.ply"
    assert main(["convert", str(run / "result.ply"), str(out), "--plain"]) == 0
    assert out.read_bytes() == (run / "result.ply").read_bytes()
