"""Web pages and other formats: what a scene's photos say of a model."""

from __future__ import annotations

import base64
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roigs_engine.cli import main
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import UP
from roigs_engine.exchange.page import Ball, viewpoint
from roigs_engine.formats.gravity import gravity_alignment
from roigs_engine.formats.splat_ply import write_ply
from tests.engine import synthetic_colmap
from tests.engine.clouds import cloud
from tests.engine.page_cases import (
    arrays,
    description,
)
from tests.engine.synthetic_colmap import ring, write_project

pytest.importorskip("gsply")


def test_the_view_is_past_what_is_in_the_way() -> None:
    """A wall before the object, and another behind it as its background."""
    random = np.random.default_rng(0)
    wall = random.uniform(-3, 3, (4000, 3))
    wall[:2000, 0], wall[2000:, 2] = 2.0, -2.0
    values = {**cloud(4000).arrays(), "means": wall.astype(np.float32)}
    eye = viewpoint(values, Ball(centre=np.zeros(3), radius=0.5))
    assert eye[2] > 0.5 and eye[1] > 0


def embedded_means(path: Path) -> np.ndarray:
    """Positions of the page's model, along x in ascending order."""
    text = path.read_text(encoding="utf-8")
    packed = re.search('<script id="After" type="text/plain">(.*?)</script>', text)
    assert packed is not None
    model = path.with_suffix(".spz")
    model.write_bytes(base64.b64decode(packed[1]))
    means = formats.read(model)["means"].astype(np.float64)
    return means[np.lexsort(np.round(means, 4).T[::-1])]


def test_a_scene_says_what_is_up_and_where_photos_were_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.4, 0.5, 0.9]).as_matrix()
    monkeypatch.setattr(synthetic_colmap, "ring", lambda *given: ring(*given) @ turned)
    names = [f"{k}.png" for k in range(8)]
    scene = write_project(run / "colmap", names=names, arc=np.pi).folder
    values = arrays()
    values["means"] = np.random.default_rng(0).normal(0, 0.1, (300, 3)).astype(np.float32)
    write_ply(run / "result.ply", values)
    given = ["convert", str(run / "result.ply"), str(tmp_path / "a.html"), "--scene", str(scene)]
    assert main(given) == 0
    place = description(tmp_path / "a.html")["places"][0]
    away = np.array(place["position"]) - place["target"]
    assert place["target"] == pytest.approx([0, 0, 0], abs=0.01)
    assert np.linalg.norm(away) == pytest.approx(np.sqrt(17), abs=0.01)  # as far as the photos
    assert np.degrees(np.arctan2(away[1], np.hypot(away[0], away[2]))) == pytest.approx(14, abs=2)
    assert main(given[:-2]) == 0  # the run folder's own
    assert description(tmp_path / "a.html")["places"][0] == place
    assert main([*given, "--from-up", "z"]) == 2
    # A file that was turned stands where the scene has it.
    assert main(["convert", str(run / "result.ply"), str(run / "result.glb")]) == 0
    given[1:3] = [str(run / "result.glb"), str(tmp_path / "b.html")]
    assert main(given) == 0
    models = [embedded_means(tmp_path / name) for name in ("a.html", "b.html")]
    np.testing.assert_allclose(models[1], models[0], atol=1e-3)


def run_of(up: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder with its project, in which an axis points up."""
    before = gravity_alignment(ring(8, np.pi))[2]
    wanted = np.array(UP[up])[:, 2]
    turned = np.eye(4)
    turned[:3, :3] = Rotation.align_vectors([before], [wanted])[0].as_matrix()
    monkeypatch.setattr(synthetic_colmap, "ring", lambda *given: ring(*given) @ turned)
    run = folder / "run"
    write_project(run / "colmap", names=[f"{k}.png" for k in range(8)], arc=np.pi)
    return run


@pytest.mark.parametrize("up", UP)
def test_a_model_that_would_lie_on_its_side_is_named(
    up: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the photos of the run that made it: the projects of `reconstruct` have z up."""
    run = run_of(up, tmp_path, monkeypatch)
    (run / "rois").mkdir()
    for name in ("result.ply", "rois/vase.ply", "mine.ply"):
        write_ply(run / name, arrays())
        assert main(["convert", str(run / name), str(tmp_path / "a.glb")]) == 0
        said = capsys.readouterr().err
        warned = up != "-y" and name != "mine.ply"
        assert (f"Choose {up} as its up axis (--from-up={up})" in said) == warned
        assert main(["convert", str(run / name), str(tmp_path / "a.glb"), f"--from-up={up}"]) == 0
        assert "lies on its side" not in capsys.readouterr().err


def test_which_way_is_up_needs_the_poses_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not the photos, nor the points, which take long to read."""
    run = run_of("z", tmp_path, monkeypatch)
    write_ply(run / "result.ply", arrays())
    shutil.rmtree(run / "colmap" / "images")
    (points,) = run.rglob("points3D.*")
    points.write_bytes(b"?")
    command = ["convert", str(run / "result.ply"), str(tmp_path / "a.glb")]
    assert main(command) == 0
    assert "--from-up=z" in capsys.readouterr().err
    (images,) = run.rglob("images.*")
    images.write_bytes(b"?")
    assert main(command) == 0
    assert "--from-up=" not in capsys.readouterr().err


def test_a_list_of_models_says_where_photos_were_taken(tmp_path: Path, capsys: Any) -> None:
    values = arrays()
    values["means"] = np.random.default_rng(0).normal(0, 0.1, (300, 3)).astype(np.float32)
    write_ply(tmp_path / "a.ply", values)
    model = {"ply": str(tmp_path / "a.ply"), "matrix": np.eye(4).tolist()}
    # Two cameras on the x axis, 3 from the origin and looking there; z is up.
    poses = [[[0, s, 0, 0], [0, 0, -1, 0], [-s, 0, 0, 3], [0, 0, 0, 1]] for s in (1, -1)]

    def written(photos: object) -> int:
        (tmp_path / "a.json").write_text(json.dumps({"models": [model], "photos": photos}))
        out = str(tmp_path / "a.html")
        return main(["convert", str(tmp_path / "a.json"), out, "--from-up", "z"])

    assert written(poses) == 0
    place = description(tmp_path / "a.html")["places"][0]
    assert np.abs(place["position"]) == pytest.approx([3, 0, 0], abs=0.1)
    assert written([]) == 0
    assert description(tmp_path / "a.html")["places"][0] != place
    for damaged in ([[1]], 5, [[[float("nan")] * 4] * 4]):
        assert written(damaged) == 2
        assert "malformed" in capsys.readouterr().err
