"""`adapt`: a finished model, made for another renderer by a short training on its photos."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roigs_engine.app.adapt import adapt, adapted
from roigs_engine.app.inputs import load_scene
from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.splat_ply import target_of
from roigs_engine.formats.targets import CYCLES, PLAIN, TARGETS, VIEWERS
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.rasterize.view import render_view
from roigs_engine.requests.models import Adapt
from roigs_engine.training.stage_data import StageData
from tests.engine.commands.command_line import refused
from tests.engine.synthetic_colmap import Project
from tests.engine.synthetic_scene import make_scene, stage_data, truth


@pytest.fixture
def model(project: Project, tmp_path: Path) -> Path:
    """Gaussians at the scene's points."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (80, 3))
    made = Gaussians.from_points(points, np.full((80, 3), 200, np.uint8))
    replace(made, target=VIEWERS).save_ply(tmp_path / "model.ply")
    return tmp_path / "model.ply"


def asked(project: Project, model: Path, made_for: str = "cycles") -> list[str]:
    options = ["--scene", str(project.folder), "--made-for", made_for, "--steps", "2"]
    return ["adapt", str(model), *options, "--device", "cpu"]


def test_a_model_trained_in_sRGB_gains_in_linear_light(tmp_path: Path) -> None:  # noqa: N802
    scene = make_scene(tmp_path, views=6)
    data = stage_data(scene)

    def error(model: Gaussians) -> float:
        shown = [render_view(model, i.camera, i.world_to_camera).image for i in scene.images]
        photos = [torch.from_numpy(data.photos[k]) / 255 for k in range(len(shown))]
        return float((torch.stack(shown) - torch.stack(photos)).square().mean())

    start = truth()
    assert 3 * error(start) < error(replace(start, target=CYCLES))
    made = adapted(start, data, CYCLES, 60)
    assert made.target == CYCLES and len(made) == len(start)
    assert error(made) < 0.5 * error(replace(start, target=CYCLES))
    assert float((made.means - start.means).abs().max()) < 0.2  # row by row


def test_without_antialiasing_it_starts_as_faint_as_it_looks(tmp_path: Path) -> None:
    data, model = stage_data(make_scene(tmp_path, views=6)), truth()
    fine = replace(model, log_scales=model.log_scales - 3.0, target=VIEWERS)
    opacity, made = fine.logit_opacities.sigmoid(), adapted(fine, data, PLAIN, 1)
    assert float((made.logit_opacities.sigmoid() / opacity).mean()) < 0.7
    same = adapted(fine, data, CYCLES, 1)
    assert float((same.logit_opacities.sigmoid() / opacity).mean()) > 0.9


@pytest.mark.parametrize("name", TARGETS)
def test_the_file_says_what_it_is_made_for(
    project: Project, model: Path, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "out.ply"
    assert main([*asked(project, model, name), "--out", str(out)]) == 0
    assert target_of(out) == TARGETS[name]
    before, after = Gaussians.load_ply(model), Gaussians.load_ply(out)
    assert len(after) == len(before)
    assert not torch.equal(after.sh, before.sh)
    torch.testing.assert_close(after.means, before.means, atol=0.05, rtol=0)


def test_a_result_knows_its_scene_and_its_test_photos(
    project: Project, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    model.rename(run / "result.ply")
    (run / "settings.json").write_text(json.dumps({"scene": str(project.folder)}))
    (run / "split.json").write_text(json.dumps({"evaluate_on": "test", "test": ["3.png", "x"]}))
    out = tmp_path / "out.ply"
    line = ["adapt", str(run / "result.ply"), "--made-for", "plain", "--steps", "1"]
    assert main([*line, "--out", str(out)]) == 0
    assert "Left out 1 photo of the run's test set." in capsys.readouterr().err
    (run / "rois").mkdir()
    line[1] = str((run / "result.ply").rename(run / "rois/vase.ply"))
    error = refused(capsys, *line, "--out", str(out))
    assert "is only a part of a result" in error and str(run / "result.ply") in error


def test_a_result_is_adapted_to_the_photos_of_its_run(
    project: Project, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without excluded photos, with the run's masks, and levelled as in training or not."""
    run, used = tmp_path / "run", project.names[1:]
    run.mkdir()
    model.rename(run / "result.ply")
    (run / "manifest.json").write_text(json.dumps({"contents": dict.fromkeys(used, "")}))
    asked: list[Adapt] = []
    trained: list[list[str]] = []

    def load(request: Adapt, *args: Any, **options: Any) -> SfmScene:
        asked.append(request)
        return load_scene(request, *args, **options)

    def train(made: Gaussians, data: StageData, *_: object) -> Gaussians:
        trained.append([image.name for image in data.images])
        return made

    monkeypatch.setattr("roigs_engine.app.adapt.load_scene", load)
    monkeypatch.setattr("roigs_engine.app.adapt.adapted", train)
    request = Adapt(model=run / "result.ply", made_for="cycles", out=tmp_path / "out.ply")
    for settings in ({}, {"no_exposures": True, "no_masks": True}):
        found = {"scene": str(project.folder), **settings}
        (run / "settings.json").write_text(json.dumps(found))
        adapt(request)
        assert trained[-1] == sorted(used)
        assert asked[-1].no_exposures == asked[-1].no_masks == bool(settings)
    adapt(replace(request, invert_masks=True))  # what the user says counts
    assert asked[-1].invert_masks and not asked[-1].no_exposures


def test_refusals(
    project: Project, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out.ply")
    line = asked(project, model)
    assert "not the name of a PLY" in refused(capsys, *line, "--out", str(tmp_path / "a.spz"))
    assert "is an input" in refused(capsys, *line, "--out", str(model))
    lone = ["adapt", str(model), "--made-for", "cycles", "--out", out]
    assert "--scene" in refused(capsys, *lone)
    far = Gaussians.load_ply(model)
    replace(far, means=far.means + 1e4).save_ply(tmp_path / "far.ply")
    error = refused(capsys, *asked(project, tmp_path / "far.ply"), "--out", out)
    assert "No photo of" in error and "far.ply" in error
    assert not Path(out).exists()


def test_a_stop_leaves_nothing(
    project: Project, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    asked_for = []

    def should_stop() -> bool:
        asked_for.append(True)
        return len(asked_for) > 12

    request = Adapt(
        model=model,
        scene=project.folder,
        made_for="cycles",
        steps=1000,
        device="cpu",
        out=tmp_path / "out.ply",
    )
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(Stopped):
        adapt(request, Context(should_stop=should_stop))
    assert sorted(tmp_path.rglob("*")) == before
