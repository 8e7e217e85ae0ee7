"""A file with options in the place of options."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.cli import main
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import Project


def options_file(folder: Path, **values: object) -> Path:
    path = folder / "options.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def test_a_options_file_stands_for_options(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = options_file(
        tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2, out=str(tmp_path)
    )
    assert main(["select", str(file)]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["method"], len(stored["names"])) == ("fvs", 2)
    # What is null is as if it were not there, and a number may be written as 640.0.
    values = {"max_side": 640.0, "count": 2, "seed": None, "only": None, "method": None}
    same = options_file(tmp_path, scene=str(project.folder), roi=BOX, **values)
    assert main(["select", str(same)]) == 0
    options_file(
        tmp_path, scene=str(project.folder), roi=[BOX], method="fvs", count=2, out=str(tmp_path)
    )
    # An option beside the file wins.
    assert main(["select", str(file), "--count", "4"]) == 0
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
        ({"max-side": 10**400}, "max_side"),
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
