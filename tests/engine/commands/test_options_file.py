"""A file with options in the place of options."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.errors import shortened
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import Project


def options_file(folder: Path, **values: object) -> Path:
    path = folder / "options.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def test_a_options_file_stands_for_options(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2)
    out = ["--out", str(tmp_path)]
    assert main(["select", str(file), *out]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["method"], len(stored["names"])) == ("fvs", 2)
    # What is null is as if it were not there, and a number may be written as 640.0.
    values = {"max_side": 640.0, "count": 2, "seed": None, "only": None, "method": None}
    same = options_file(tmp_path, scene=str(project.folder), roi=BOX, **values)
    assert main(["select", str(same)]) == 0
    options_file(tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2)
    # An option beside the file wins.
    assert main(["select", str(file), "--count", "4", *out]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["method"], len(stored["names"])) == ("fvs", 4)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"colour": "blue"}, "'colour'"),
        ({"help": True}, "'help'"),
        ({"method": "best"}, "'method'"),
        ({"count": "many"}, "'count'"),
        ({"count": "3"}, "'count'"),
        ({"count": 2.5}, "'count'"),
        ({"count": True}, "'count'"),
        ({"count": float("inf")}, "'count'"),
        ({"count": [1, 2]}, "'count'"),
        ({"max-side": 10**400}, "max-side"),
        ({"downscale": 10**400}, "'downscale'"),
        ({"only": [5]}, "'only'"),
        ({"only": {"a": 1}}, "'only'"),
        ({"method": ["static"]}, "'method'"),
        ({"events": 1}, "'events'"),
        ({"images": "a\0b"}, "'images'"),
        ({"images": "x" * 5000}, "xxx"),
        ({"rois": 5}, "'rois'"),
        ({"threads": float("nan")}, "'threads'"),
        ({"seed": 1 << 40, "method": "random"}, "seed"),
        ({"events": True}, "'events'"),
        ({"max_side": 40, "downscale": 2.0}, "'downscale'"),
    ],
)
def test_an_options_file_with_a_wrong_key_or_value_is_refused(
    project: Project,
    tmp_path: Path,
    values: dict[str, object],
    named: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), roi=[BOX], **values)
    assert named in refused(capsys, "select", file)


@pytest.mark.parametrize(
    "text",
    [
        '{"scene": "garden", "max_side": 640, "max_side": 320}',
        '{"scene": "garden", "max_side": 640, "max-side": null}',
        '{"scene": "garden", "scene": "kitchen", "max_side": 640}',
    ],
)
def test_a_key_that_is_there_twice_is_refused(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "options.json"
    file.write_text(text, encoding="utf-8")
    line = refused(capsys, "inspect", file)
    twice = "'scene'" if "kitchen" in text else "'max_side'"
    assert twice in line and "options.json" in line


@pytest.mark.parametrize(
    ("command", "key", "value", "flag"),
    [
        ("train", "cluster", "ray://elsewhere:10001", "--cluster"),
        ("train", "run-dir", "/home/somebody", "--run-dir"),
        ("export", "out", "/home/somebody", "--out"),
    ],
)
def test_a_file_says_neither_where_to_write_nor_where_to_connect(
    project: Project,
    tmp_path: Path,
    command: str,
    key: str,
    value: str,
    flag: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = options_file(tmp_path, **{"scene": str(project.folder), key: value})
    for more in ((), (flag, tmp_path / "mine")):
        line = refused(capsys, command, file, *more)
        assert f"must not have the key '{key}'" in line and flag in line
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize("values", [{}, {"run_dir": None}])
def test_what_neither_the_file_nor_the_command_line_has_is_missed(
    project: Project,
    tmp_path: Path,
    values: dict[str, object],
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), roi=BOX, **values)
    assert "required: --run-dir" in refused(capsys, "train", file)
    assert "required: scene, --run-dir" in refused(capsys, "train")
    file = options_file(tmp_path, scene=str(project.folder), roi=BOX, model=[])
    assert "required: --model" in refused(capsys, "evaluate", file, "--out", tmp_path)


def test_an_option_beside_the_file_wins_over_what_excludes_it(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = options_file(tmp_path, scene=str(project.folder), max_side=20)

    def width(*options: object) -> int:
        assert main(["export", str(file), "--out", str(tmp_path), *map(str, options)]) == 0
        return int(json.loads((tmp_path / "scene.json").read_text("utf-8"))["largest"][0])

    assert width() == 20
    assert width("--downscale", 1) == 2 * width("--downscale", 2) > 40


def test_an_options_file_that_is_none_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "scene" in refused(capsys, "select", options_file(tmp_path, roi=[BOX]))
    broken = tmp_path / "broken.json"
    broken.write_text("{", encoding="utf-8")
    assert "broken.json" in refused(capsys, "select", broken)
    assert "gone.json" in refused(capsys, "select", tmp_path / "gone.json")
    assert "xxx" in refused(capsys, "select", options_file(tmp_path, scene="x" * 5000, roi=[BOX]))


def test_a_run_folders_settings_are_an_options_file(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, tiny = tmp_path / "run", ("--steps-factor", "0.003", "--max-side", "40", "--device", "cpu")
    more = ("--test-every", "0", "--update", "--preview-seconds", "1")
    line = ("train", str(project.folder), "--roi", BOX, "--run-dir", str(run), *tiny, *more)
    assert main([*line]) == 0
    settings = json.loads((run / "settings.json").read_text(encoding="utf-8"))
    assert settings == {
        "scene": str(project.folder),
        "roi": [BOX],
        "preset": "draft",
        "test_every": 0,
        "steps_factor": 0.003,
        "max_side": 40,
    }
    capsys.readouterr()
    assert main(["train", str(run / "settings.json"), "--run-dir", str(run)]) == 0
    assert "joint: finished in an earlier training" in capsys.readouterr().err
    assert main([*line, "--seed", "1"]) == 0
    (earlier,) = (run / "earlier").glob("*/settings.json")
    assert json.loads(earlier.read_text(encoding="utf-8")) == settings


@pytest.mark.parametrize("key", ["group", "only", "images", "method", "roi", "x" * 1_000_000])
def test_a_text_of_a_million_letters_is_not_repeated(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str
) -> None:
    """The line had a megabyte; beside JSON, Blender would have dropped it."""
    long = "x" * 1_000_000
    values = {"roi": [BOX], "device": "cpu", key: [long] if key in ("group", "only") else long}
    file = options_file(tmp_path, scene=str(project.folder), **values)
    said = refused(capsys, "train", file, "--run-dir", tmp_path / "run", "--dry-run")
    assert len(said) < 1600
    assert key[:9] in said or "box" in said.lower()


def test_a_shortened_text_keeps_its_ends() -> None:
    assert shortened("a" * 1000) == "a" * 1000
    found = shortened("a" * 1500 + "b" * 1500)
    assert len(found) == 1000
    assert found[:600] == "a" * 600
    assert found[-300:] == "b" * 300
    assert " … " in found


def test_thousands_of_boxes_are_refused(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A plan took minutes, without a line."""
    boxes = [f"a{k}=0,0,0,1,1,1" for k in range(3000)]
    file = options_file(tmp_path, scene=str(project.folder), roi=boxes, device="cpu")
    said = refused(capsys, "train", file, "--run-dir", tmp_path / "run", "--dry-run")
    assert "There are 3,000 boxes; at most 500 are used." in said
    rois = tmp_path / "rois.json"
    box = {"min": [0, 0, 0], "max": [1, 1, 1]}
    rois.write_text(json.dumps([{"name": f"a{k}", **box} for k in range(501)]), encoding="utf-8")
    assert "There are 501 boxes" in refused(capsys, "inspect", project.folder, "--rois", rois)
