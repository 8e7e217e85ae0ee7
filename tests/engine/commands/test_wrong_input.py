"""Wrong input is one line and status 2."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import BOX, EMPTY, python, refused
from tests.engine.synthetic_colmap import Project, write_project


def write_one_gaussian(folder: Path) -> Path:
    path = folder / "one.ply"
    Gaussians.from_points(np.array([[0.0, 0, 3]]), np.zeros((1, 3), np.uint8)).save_ply(path)
    return path


def test_no_roi(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--roi" in refused(capsys, "select", project.folder)


def test_unknown_roi_name(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "select", project.folder, "--roi", BOX, "--only", "vase")
    assert "'vase'" in line and "thing" in line


@pytest.mark.parametrize("text", ["thing", "thing=1,2,3", "=0,0,0,1,1,1", "a=0,0,0,1,1,x"])
def test_malformed_roi(project: Project, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, "select", project.folder, "--roi", text)


def test_roi_without_volume(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert "'flat'" in refused(capsys, "select", project.folder, "--roi", "flat=0,0,0,1,1,0")


def test_two_rois_of_one_name(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "inspect", project.folder, "--roi", BOX, "--roi", BOX)
    assert "'thing'" in line


def test_box_without_points_names_box_and_nearest_points(project: Project) -> None:
    result = python("select", project.folder, "--roi", EMPTY)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert "'nothing'" in line and "Nearest points" in line
    assert "1 x 1 x 1" in line


def test_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert str(tmp_path) in refused(capsys, "inspect", tmp_path)
    assert "nowhere" in refused(capsys, "inspect", tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("damage", ["cut", "noise"])
def test_unreadable_model(
    tmp_path: Path, name: str, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_project(tmp_path).folder / "sparse" / "0" / name
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] if damage == "cut" else b"\xff" * len(data))
    assert name in refused(capsys, "select", tmp_path, "--roi", BOX)


def test_no_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_project(tmp_path, images=None)
    assert "--images" in refused(capsys, "select", tmp_path, "--roi", BOX)


def test_no_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import numpy as np

    write_project(tmp_path, points=np.zeros((0, 3)))
    assert "points" in refused(capsys, "select", tmp_path, "--roi", BOX)


@pytest.mark.parametrize(
    "options",
    [
        ["--count", "0"],
        ["--seed", "-1"],
        ["--downscale", "0"],
        ["--max-side", "0"],
        ["--test-every", "1"],
        ["--rois", "missing.json"],
    ],
)
def test_values_out_of_range(
    project: Project, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, "select", project.folder, "--roi", BOX, *options)


@pytest.mark.parametrize(
    "options",
    [["--steps-factor", "0"], ["--image-cache", "-2"], ["--test-every", "1"], ["--count", "-3"]],
)
def test_training_values_out_of_range(
    project: Project, tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    refused(capsys, "train", project.folder, "--roi", BOX, "--run-dir", folder, *options)
    assert not folder.exists(), "a refused command leaves nothing behind"


def test_files_that_are_no_splats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ply = tmp_path / "a.ply"
    ply.write_bytes(b"ply\nnothing\n")
    out = tmp_path / "out.ply"
    line = refused(capsys, "compose", ply, "--roi", BOX, "--object", f"thing={ply}", "--out", out)
    assert "a.ply" in line
    assert not out.exists()
    cameras = tmp_path / "cameras.json"
    model = f"thing={write_one_gaussian(tmp_path)}"
    command = ["compose", tmp_path / "one.ply", "--roi", BOX, "--object", model]
    assert "twice" in refused(capsys, *command, "--object", model, "--out", out)
    record = {"name": "a", "width": 8, "height": 8, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0}
    record["world_to_camera"] = np.eye(4).tolist()
    cameras.write_text(json.dumps({"cameras": [record]}), encoding="utf-8")
    command = ["render", tmp_path / "one.ply", "--path", cameras, "--out", tmp_path]
    command += ["--device", "cpu"]  # else it says why not on a card
    assert "'b'" in refused(capsys, *command, "--name", "b")
    line = refused(capsys, "render", tmp_path / "no.ply", "--path", cameras, "--out", tmp_path)
    assert "no.ply" in line


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (("select", "scene", "--out", "out", "--colour", "blue"), "--colour"),
        (("inspect", "scene", "--max-side", "large"), "--max-side"),
        (("train", "scene"), "--run-dir"),
        (("paint", "scene"), "paint"),
    ],
)
def test_options_that_do_not_fit(
    given: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, *given)
    assert named in line and "--help" in line


def test_options_that_do_not_fit_are_an_event(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "scene", "--run-dir", "run", "--preset", "best", "--events"]) == 2
    event = json.loads(capsys.readouterr().out)
    assert event["event"] == "failed" and "best" in event["message"]


def test_no_test_photos(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [project.folder, "--roi", BOX, "--run-dir", tmp_path / "run", "--test-every", 0]
    assert "`train`" in refused(capsys, "run", *arguments)
    assert not (tmp_path / "run").exists()


def test_a_selection_folder_without_the_boxes_is_refused(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [project.folder, "--roi", BOX, "--run-dir", tmp_path / "run"]
    assert "thing.json" in refused(capsys, "train", *arguments, "--selection", tmp_path)
    (tmp_path / "thing.json").write_text("{}", encoding="utf-8")
    assert "'names'" in refused(capsys, "train", *arguments, "--selection", tmp_path)
    assert not (tmp_path / "run").exists()


def test_what_does_not_fit_into_memory_is_one_line(
    project: Project, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for error in (MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory")):

        def fail(*_: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr("roigs_engine.app.scenes.inspect", fail)
        assert "memory" in refused(capsys, "inspect", project.folder)


def test_compose_overwrites_no_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ply = write_one_gaussian(tmp_path)
    inside, before = "thing=-1,-1,2,1,1,4", ply.read_bytes()
    command = ["compose", ply, "--roi", inside, "--object", f"thing={ply}", "--out"]
    assert "input" in refused(capsys, *command, ply)
    rois = tmp_path / "rois.json"
    rois.write_text("{}", encoding="utf-8")
    assert ".ply" in refused(capsys, *command, rois)
    assert ply.read_bytes() == before and rois.read_text(encoding="utf-8") == "{}"
    away = ["compose", ply, "--roi", BOX, "--object", f"thing={ply}", "--out", tmp_path / "a.ply"]
    assert "has no Gaussian in box 'thing'" in refused(capsys, *away)


def test_boxes_in_other_units_than_the_model(
    tmp_path: Path, project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    far = "thing=900,900,900,905,905,905"
    arguments = [project.folder, "--roi", far, "--run-dir", tmp_path / "run"]
    assert main(["train", *map(str, arguments)]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "sides 5 x 5 x 5" in line and "units" in line  # the user's numbers
