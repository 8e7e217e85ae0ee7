"""Confidence of each Gaussian: number of photos and directions, colour errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.evaluation.confidence import confidence
from roigs_engine.formats.confidence import COLUMNS, STOPS, colours, most_directions
from roigs_engine.formats.splat_ply import read_ply, write_ply
from roigs_engine.model.gaussians import SH_C0, Gaussians
from tests.engine.ball_runs import write_run
from tests.engine.commands.command_line import refused
from tests.engine.levels.balls import cloud
from tests.engine.synthetic_scene import make_scene, truth
from tests.engine.training.floaters.photos import at, gaussians, photo, ring


def test_photos_and_directions_are_counted() -> None:
    near = [photo(f"again-{k}.png", at(0.0, 4.0 + 0.1 * k)) for k in range(3)]
    model = gaussians((np.zeros(3), 0.1), (np.array([0, 0, 90.0]), 0.1))
    found = confidence(model, [*ring(8), *near], [])
    assert found.photos.tolist() == [11, 0]
    assert found.directions.tolist() == [8, 0]  # three more from the place of the first add none
    assert np.isnan(found.error).all()


def test_what_is_hidden_is_not_seen() -> None:
    behind, front = np.array([-0.6, 0, 0]), np.array([0.6, 0, 0])
    model = gaussians((behind, 0.1), (front, 0.3), (front, 0.3), (front, 0.3))
    found = confidence(model, [photo("a.png", at(0.0)), photo("b.png", at(0.5))], [])
    assert found.photos[0] == 1 and found.photos[1:].max() == 2


def test_a_gap_is_found() -> None:
    """Photos of one half alone: what faces the other half is known from fewer directions."""
    around = np.array([[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 2 * np.pi, 16)[:-1]])
    wall = [(np.zeros(3), 0.6)] * 4
    model = gaussians(*((place * 0.5, 0.05) for place in around), *wall)
    half = [photo(f"{k}.png", at(share)) for k, share in enumerate(np.linspace(-0.2, 0.2, 9))]
    found = confidence(model, half, [])
    seen, gap = around[:, 0] > 0.5, around[:, 0] < -0.8
    assert found.directions[:15][seen].min() >= 3
    assert found.directions[:15][gap].max() < 3


def test_an_error_falls_on_what_the_pixel_shows(tmp_path: Path) -> None:
    scene, model = make_scene(tmp_path), truth()
    right = confidence(model, scene.images, scene.images)
    assert np.nanmax(right.error[:150]) < 0.02  # eight bits, and what pictures leave out
    sh = model.sh.clone()
    wrong = int(np.argmax(right.photos[:150]))
    sh[wrong, 0] += 0.3 / SH_C0
    found = confidence(replace(model, sh=sh), scene.images, scene.images)
    assert np.nanargmax(found.error[:150]) == wrong
    assert 0.05 < found.error[wrong] < 0.3


def test_colours_go_from_few_to_many() -> None:
    directions = np.array([0, 5, 10, 40, np.nan], np.float32)
    assert np.allclose(colours(directions, 10.0), STOPS[[0, 1, 2, 2, 0]])
    assert most_directions(np.array([], np.float32)) == 1
    assert most_directions(np.r_[np.arange(100.0), np.nan].astype(np.float32)) == pytest.approx(
        94.05
    )


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path)


def test_the_command_writes_columns_and_a_heat_map(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = json.loads((run / "settings.json").read_text()) | {"test_every": 3}
    (run / "settings.json").write_text(json.dumps(settings))
    before = (run / "result.ply").read_bytes()
    words = ["confidence", str(run), "--device", "cpu", "--out"]
    assert main([*words, str(tmp_path / "known.ply")]) == 0
    assert "seen from fewer than 3 directions" in capsys.readouterr().out
    assert (run / "result.ply").read_bytes() == before
    head = (tmp_path / "known.ply").read_bytes().split(b"end_header")[0].decode()
    assert head.rstrip().splitlines()[-3:] == [f"property float {name}" for name in COLUMNS]
    original, known = read_ply(run / "result.ply"), read_ply(tmp_path / "known.ply")
    assert all(np.allclose(known[name], original[name], atol=1e-5) for name in original)

    assert main([*words, str(tmp_path / "known.npy")]) == 0
    table = np.load(tmp_path / "known.npy")
    assert table.shape == (len(original["means"]), 3) and table[:, 0].max() == 4
    assert np.isfinite(table[:, 2]).any()

    assert main([*words, str(tmp_path / "heat.ply"), "--heat-map"]) == 0
    heat = read_ply(tmp_path / "heat.ply")
    shown = colours(table[:, 1], most_directions(table[:, 1]))
    assert np.allclose(0.5 + SH_C0 * heat["sh"][:, 0], shown, atol=1e-5)


def test_rows_that_cannot_be_drawn_know_nothing(run: Path, tmp_path: Path) -> None:
    arrays = cloud(200, 0, size=0.4).arrays()
    arrays["means"][7] = np.nan
    write_ply(tmp_path / "some.ply", arrays)
    given = ["--model", str(tmp_path / "some.ply"), "--device", "cpu"]
    assert main(["confidence", str(run), *given, "--out", str(tmp_path / "some.npy")]) == 0
    table = np.load(tmp_path / "some.npy")
    assert np.isnan(table[7]).all() and np.isfinite(table[np.arange(200) != 7, :2]).all()


def test_wrong_input_is_one_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "known.ply"
    assert "not a run folder" in refused(capsys, "confidence", tmp_path, "--out", out)
    said = refused(capsys, "confidence", run, "--out", tmp_path / "known.txt")
    assert "neither a PLY nor a NumPy file" in said
    said = refused(capsys, "confidence", run, "--heat-map", "--out", tmp_path / "known.npy")
    assert "--heat-map colours a PLY" in said
    assert "is an input" in refused(capsys, "confidence", run, "--out", run / "result.ply")
    lost = refused(capsys, "confidence", run, "--model", tmp_path / "lost.ply", "--out", out)
    assert "lost.ply" in lost
    assert not out.exists()


def test_nothing_is_no_error() -> None:
    nothing = Gaussians.from_arrays({name: a[:0] for name, a in truth().arrays().items()})
    assert len(confidence(nothing, ring(3), []).photos) == 0
