"""`floaters`: which Gaussians of a file hang in the air."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.app.instances import InstanceRecord, as_one
from roigs_engine.cli import main
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import target_with
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import PosedImage
from tests.engine.clouds import cloud
from tests.engine.commands.command_line import BOX
from tests.engine.synthetic_colmap import Project


def speck(centre: np.ndarray, size: float) -> dict[str, np.ndarray]:
    """One opaque ball."""
    return {
        "means": centre[None].astype(np.float32),
        "quats": np.array([[1, 0, 0, 0]], np.float32),
        "log_scales": np.full((1, 3), np.log(size), np.float32),
        "logit_opacities": np.array([6.0], np.float32),
        "sh": np.zeros((1, 1, 3), np.float32),
    }


def beside(image: PosedImage) -> np.ndarray:
    """A place behind a photo's camera, far from the scene."""
    return image.centre - 0.1 * np.linalg.norm(image.centre) * image.forward


def joined(*parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def found(project: Project, model: Path, out: Path, *more: str) -> np.ndarray:
    options = ["--model", str(model), "--out", str(out), "--device", "cpu", *more]
    assert main(["floaters", str(project.folder), *options]) == 0
    return np.load(out)


def test_what_hangs_among_the_cameras(project: Project, tmp_path: Path) -> None:
    """A ball beside a camera goes, the scene's own points stay, what cannot be drawn too."""
    scene = load_colmap(project.folder)
    close = beside(scene.images[0])
    own = [speck(point, 0.02) for point in scene.points[:40].astype(float)]
    broken = speck(close, np.nan)
    write_ply(tmp_path / "a.ply", joined(broken, *own, speck(close, 0.02)))
    mask = found(project, tmp_path / "a.ply", tmp_path / "out.npy", "--roi", BOX)
    assert mask.dtype == bool and len(mask) == 42
    assert mask[-1] and not mask[0] and mask.sum() < 10


def test_opaque_and_flat_ones_are_judged(project: Project, tmp_path: Path) -> None:
    """Opacities of 1 and sizes of 0 are infinite logarithms; such Gaussians were left out."""
    scene = load_colmap(project.folder)
    ball = speck(beside(scene.images[0]), 0.02)
    ball["logit_opacities"][:], ball["log_scales"][:, 0] = np.inf, -np.inf
    own = [speck(point, 0.02) for point in scene.points[:40].astype(float)]
    write_ply(tmp_path / "a.ply", joined(*own, ball))
    assert found(project, tmp_path / "a.ply", tmp_path / "out.npy", "--roi", BOX)[-1]


def test_files_in_their_places(project: Project, tmp_path: Path) -> None:
    """The same model, moved in its file and back in the list, gives the same answer."""
    scene = load_colmap(project.folder)
    close = beside(scene.images[0])
    own = joined(*(speck(point, 0.02) for point in scene.points[:40].astype(float)))
    moved = {**own, "means": own["means"] + np.float32(7)}
    write_ply(tmp_path / "a.ply", joined(own, speck(close, 0.02)))
    write_ply(tmp_path / "moved.ply", moved)
    write_ply(tmp_path / "speck.ply", speck(close, 0.02))
    back = np.eye(4)
    back[:3, 3] = -7
    models = [("moved.ply", back), ("speck.ply", np.eye(4))]
    record = [{"ply": name, "matrix": m.tolist()} for name, m in models]  # beside the list
    (tmp_path / "list.json").write_text(json.dumps({"models": record}))
    whole = found(project, tmp_path / "a.ply", tmp_path / "a.npy")
    np.testing.assert_array_equal(found(project, tmp_path / "list.json", tmp_path / "b.npy"), whole)


def test_a_model_stays_antialiased(tmp_path: Path) -> None:
    for antialiased in (False, True):
        replace(cloud(), target=target_with(antialiased=antialiased)).save_ply(tmp_path / "a.ply")
        wanted = [InstanceRecord(str(tmp_path / "a.ply"), np.eye(4))]
        model, _ = as_one(wanted, LocalFrame.world(), QUIET)
        assert model.antialiased is antialiased


def test_wrong_input_is_one_line(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cloud().save_ply(tmp_path / "a.ply")
    (tmp_path / "bad.json").write_text('{"models": [{}]}')
    for model, said in (("gone.ply", "gone.ply"), ("bad.json", "malformed (a model has no 'ply')")):
        options = ["--model", str(tmp_path / model), "--out", str(tmp_path / "o.npy")]
        assert main(["floaters", str(project.folder), *options]) == 2
        error = capsys.readouterr().err
        assert said in error and "Traceback" not in error
    same = ["--model", str(tmp_path / "a.ply"), "--out", str(tmp_path / "a.ply")]
    assert main(["floaters", str(project.folder), *same]) == 2
    assert not (tmp_path / "o.npy").exists()


@pytest.mark.parametrize(
    "linked",
    [False, pytest.param(True, marks=pytest.mark.skipif(os.name != "posix", reason="a link"))],
)
def test_a_list_that_needs_more_than_the_memory(
    project: Project,
    tmp_path: Path,
    linked: bool,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of one model, again and again: before any is read."""
    monkeypatch.setattr("roigs_engine.app.instances.machine_memory", lambda: 1_000_000)
    cloud().save_ply(tmp_path / "a.ply")
    size = (tmp_path / "a.ply").stat().st_size
    if linked:
        (tmp_path / "link.ply").symlink_to("a.ply")
    model = {"ply": "link.ply" if linked else "a.ply", "matrix": np.eye(4).tolist()}
    models = [model] * (1 + 1_000_000 // size)
    (tmp_path / "list.json").write_text(json.dumps({"models": models}))
    listed = str(tmp_path / "list.json")
    for line in (
        ["floaters", str(project.folder), "--model", listed, "--out", str(tmp_path / "o.npy")],
        ["panorama", listed, "--at=0,0,0", "--out", str(tmp_path / "o.hdr")],
    ):
        assert main(line) == 2
        assert f"{len(models):,} models of the list need" in capsys.readouterr().err


@pytest.mark.parametrize("most", [False, True])
def test_both_kinds_are_judged_as_most_are(tmp_path: Path, most: bool) -> None:
    wanted = []
    for antialiased in (False, True):
        models = [cloud()] * (3 if antialiased == most else 1)
        path = tmp_path / f"{antialiased}.ply"
        replace(
            Gaussians.concatenate(models), target=target_with(antialiased=antialiased)
        ).save_ply(path)
        wanted.append(InstanceRecord(str(path), np.eye(4)))
    model, rows = as_one(wanted, LocalFrame.world(), QUIET)
    assert model.antialiased is most and len(rows) == 4 * len(cloud())
