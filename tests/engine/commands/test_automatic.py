"""`--roi auto` and photos as a scene: found, written, changed, planned and refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from roigs_engine.model.roi import load_rois
from roigs_engine.requests.projects import Reconstruct
from tests.engine.commands.command_line import BOX, refused
from tests.engine.reconstruction.photo_sets import copy_photos, demo_photos
from tests.engine.synthetic_colmap import Project, write_project

TINY = ("--steps-factor", "0.003", "--test-every", "4", "--device", "cpu")


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """An object of side 0.6 in a wide ring of points."""
    random = np.random.default_rng(0)
    thing = random.uniform(-0.3, 0.3, (60, 3))
    wall = random.uniform(-1, 1, (20, 3)) * (6, 1, 6)
    names = [f"{number}.png" for number in range(10)]
    points = np.concatenate([thing, wall])
    folder = tmp_path_factory.mktemp("auto") / "a scene"
    return write_project(folder, names=names, points=points, dots=True)


def test_the_box_is_around_what_the_photos_show(project: Project, tmp_path: Path) -> None:
    arguments = ["select", project.folder, "--roi", "auto", "--out", tmp_path]
    assert main([str(word) for word in arguments]) == 0
    (box,) = load_rois(tmp_path / run_files.BOXES)
    assert np.abs(box.centre).max() < 0.15 and (np.abs(box.half_extents - 0.3) < 0.12).all()
    assert json.loads((tmp_path / f"{box.name}.json").read_text("utf-8"))["names"]


def test_a_person_can_change_the_box_of_a_run(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(project.folder), "--roi", "auto", "--run-dir", str(tmp_path / "run"), *TINY]
    assert main(["train", *words, "--dry-run"]) == 0
    assert "Box 'object'" in capsys.readouterr().out and not (tmp_path / "run").exists()
    assert main(["train", *words]) == 0
    path = tmp_path / "run" / run_files.BOXES
    assert str(path) in capsys.readouterr().err
    settings = json.loads((tmp_path / "run/settings.json").read_text("utf-8"))
    assert settings["rois"] == str(path) and "roi" not in settings
    written = path.read_bytes()
    assert main(["train", *words]) == 0 and path.read_bytes() == written
    record = json.loads(written)
    record["rois"][0]["name"] = "pot"
    record["rois"][0]["half_extents"][0] *= 1.2
    path.write_text(json.dumps(record))
    capsys.readouterr()
    assert main(["train", *words]) == 2 and "--update" in capsys.readouterr().err
    assert main(["train", *words, "--update"]) == 0
    assert (tmp_path / "run" / run_files.FINE / "pot.ply").exists()
    assert json.loads(path.read_text("utf-8")) == record


def test_another_run_is_left_as_it_is(project: Project, tmp_path: Path) -> None:
    words = [str(project.folder), "--run-dir", str(tmp_path), *TINY]
    assert main(["train", *words, "--roi", BOX]) == 0
    assert main(["train", *words, "--roi", "auto"]) == 2
    assert not (tmp_path / run_files.BOXES).exists()


def test_what_does_not_go_with_auto_is_one_line(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    auto = (project.folder, "--roi", "auto")
    assert "replaces all boxes" in refused(capsys, "select", *auto, "--roi", BOX)
    assert "option of select, suggest, train and run" in refused(capsys, "inspect", *auto)
    assert "There is no box 'vase'" in refused(capsys, "select", *auto, "--only", "vase")
    few = write_project(tmp_path / "few", points=np.eye(3))
    assert "finds no object" in refused(capsys, "select", few.folder, "--roi", "auto")


@pytest.fixture
def photos(project: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Photos whose reconstruction is the project, at once."""

    def reconstruct(request: Reconstruct, *rest: object) -> Path:
        shutil.copytree(project.folder, request.out, dirs_exist_ok=True)
        return request.out / "sparse/0"

    monkeypatch.setattr("roigs_engine.reconstruction.reconstruct.reconstruct", reconstruct)
    shutil.copytree(project.folder / "images", tmp_path / "photos")
    return tmp_path / "photos"


def test_photos_become_a_project_in_the_run_folder(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    words = [str(photos), "--roi", "auto", "--run-dir", str(run), *TINY]
    assert main(["run", *words, "--dry-run"]) == 0
    assert "1. Make a COLMAP project from 10 photos" in capsys.readouterr().out
    assert not run.exists()
    assert main(["run", *words]) == 0
    assert "ROI PSNR" in capsys.readouterr().out
    assert (run / run_files.PROJECT / "sparse/0").is_dir()
    assert "gets one" in (run / run_files.EVENTS).read_text("utf-8")
    settings = json.loads((run / run_files.SETTINGS).read_text("utf-8"))
    assert settings["scene"] == str(run / run_files.PROJECT)
    assert main(["run", *words, "--dry-run"]) == 0
    assert capsys.readouterr().out.count(" done\n") == 3


def test_a_video_is_planned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "walk.mp4").write_bytes(b"")
    words = [str(tmp_path / "walk.mp4"), "--roi", "auto", "--run-dir", str(tmp_path / "run")]
    assert main(["run", *words, "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert f"1. Make a COLMAP project from {tmp_path / 'walk.mp4'}" in shown


def test_photos_that_cannot_be_used_so_are_one_line(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inside = ("--run-dir", photos / "runs/x")
    assert "in the folder of the photos" in refused(
        capsys, "train", photos, "--roi", "auto", *inside
    )
    line = refused(capsys, "train", photos, "--roi", BOX, "--run-dir", tmp_path / "run")
    assert "has no COLMAP model, so boxes have no coordinates yet" in line
    assert not (tmp_path / "run").exists() and not (photos / "runs").exists()
    assert "has no COLMAP model" in refused(capsys, "select", photos, "--roi", "auto")


@pytest.mark.slow
def test_from_photos_to_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen = demo_photos("wide/*.jpg", 10)
    copy_photos(tmp_path / "photos", chosen, [f"ü {number}.jpg" for number in range(10)])
    words = [str(tmp_path / "photos"), "--roi", "auto", "--run-dir", str(tmp_path / "run"), *TINY]
    assert main(["run", *words, "--max-side", "160"]) == 0
    assert "ROI PSNR" in capsys.readouterr().out
    assert load_rois(tmp_path / "run" / run_files.BOXES)
    assert (tmp_path / "run" / run_files.RESULT).exists()
    assert main(["run", *words, "--max-side", "160"]) == 0
    said = capsys.readouterr().err
    assert "is up to date" in said and said.count("finished in an earlier training") == 3
