"""Photos that are damaged, change or get lost, before a run and between two."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image, ImageOps

from roigs_engine.cli import main
from roigs_engine.evaluation import evaluate
from roigs_engine.formats import run_files
from tests.engine.commands.command_line import BOX, refused
from tests.engine.commands.photo_scenes import arguments, scene
from tests.engine.runs import plys, stage_of
from tests.engine.synthetic_colmap import Project


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A scene and its run, to copy."""
    folder = tmp_path_factory.mktemp("trained")
    project = scene(folder)
    assert main(arguments(project, folder / "run")) == 0
    return project


@pytest.fixture(scope="module")
def trained_through_a_lens(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """The same with photos that the lens distorts, and cameras as text."""
    folder = tmp_path_factory.mktemp("distorted")
    project = scene(folder, distorted=True, binary=False)
    assert main(arguments(project, folder / "run")) == 0
    return project


def copy_of(project: Project, folder: Path) -> tuple[Project, Path]:
    """A copy of a scene with its run."""
    shutil.copytree(project.folder.parent, folder, dirs_exist_ok=True)
    return replace(project, folder=folder / project.folder.name), folder / "run"


@pytest.fixture
def copied(trained: Project, tmp_path: Path) -> tuple[Project, Path]:
    """Of `trained`."""
    return copy_of(trained, tmp_path)


@pytest.fixture
def distorted(trained_through_a_lens: Project, tmp_path: Path) -> tuple[Project, Path]:
    """Of `trained_through_a_lens`."""
    return copy_of(trained_through_a_lens, tmp_path)


def split_of(run: Path) -> list[str]:
    record = json.loads((run / run_files.SPLIT).read_text(encoding="utf-8"))
    return [str(name) for name in record["test"]]


@pytest.mark.parametrize("kind", ["copied", "distorted"])
def test_a_damaged_test_photo_is_left_out_before_the_split(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, request: pytest.FixtureRequest
) -> None:
    """Its file ends with an end marker, so only decoding finds the damage."""
    project, run = request.getfixturevalue(kind)
    lost = split_of(run)[0]
    path = project.folder / "images" / lost
    path.write_bytes(path.read_bytes()[:-200] + b"\xff\xd9")
    capsys.readouterr()
    assert main(arguments(project, tmp_path / "again")) == 0
    assert f"Skipped 1 photo, unreadable: {lost}." in capsys.readouterr().err
    assert lost not in split_of(tmp_path / "again")
    table = json.loads((tmp_path / "again" / run_files.REPORT_DATA).read_text(encoding="utf-8"))
    assert lost not in table["test_views"] and table["test_views"]
    inspect = ["inspect", str(project.folder)]
    assert main([*inspect, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["skipped"] == {}  # its end marker is there
    assert main([*inspect, "--json", "--check-photos"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["skipped"] == {"unreadable": {"count": 1, "first": [lost]}}
    assert report["photos"] == 9


def test_when_all_photos_are_damaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = scene(tmp_path)
    for path in (project.folder / "images").iterdir():
        path.write_bytes(path.read_bytes()[:-200] + b"\xff\xd9")
    assert main(arguments(project, tmp_path / "run")) == 2
    assert "(10 unreadable)" in capsys.readouterr().err.splitlines()[-1]
    assert main(["inspect", str(project.folder), "--check-photos"]) == 2
    assert "All 10 photos are damaged" in capsys.readouterr().err


def test_a_test_photo_lost_in_training_costs_only_its_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    project, run = scene(tmp_path), tmp_path / "run"
    measure = evaluate.plan_views

    def late(*given: object) -> object:
        (project.folder / "images" / split_of(run)[0]).unlink(missing_ok=True)
        return measure(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(evaluate, "plan_views", late)
    assert main(arguments(project, run)) == 0
    said = capsys.readouterr().err
    lost, *rest = split_of(run)
    assert lost in said and "The evaluation leaves it out." in said
    table = json.loads((run / run_files.REPORT_DATA).read_text(encoding="utf-8"))
    assert table["test_views"] == rest and rest


def test_a_test_photo_lost_later_costs_its_row(
    copied: tuple[Project, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (project, run), out = copied, tmp_path / "out"
    lost, *rest = split_of(run)
    (project.folder / "images" / lost).unlink()
    capsys.readouterr()
    words = ["--split", str(run / run_files.SPLIT), "--model", f"A={run / run_files.RESULT}"]
    command = ["evaluate", str(project.folder), "--roi", BOX, "--out", str(out), *words]
    assert main(command) == 0
    assert f"1 test photo (unusable); the first is {lost}" in capsys.readouterr().err
    table = json.loads((out / run_files.REPORT_DATA).read_text(encoding="utf-8"))
    assert table["test_views"] == rest


def test_when_all_test_photos_are_lost(
    copied: tuple[Project, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = copied
    for name in split_of(run):
        (project.folder / "images" / name).unlink()
    words = ["--model", f"A={run / run_files.RESULT}", "--out", str(tmp_path / "out")]
    capsys.readouterr()
    assert main(["evaluate", str(project.folder), "--roi", BOX, *words]) == 2
    assert "Restore the photos" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_a_selection_is_not_read_from_where_it_is_written(
    copied: tuple[Project, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = copied
    mine = (run / "selection" / "thing.json").read_bytes()
    capsys.readouterr()
    words = arguments(project, run, "--selection", str(run / "selection"))
    assert "Give a copy" in refused(capsys, *words)
    assert (run / "selection" / "thing.json").read_bytes() == mine


@pytest.mark.parametrize("name", ["result.ply", "report.md", "rois/thing.ply"])
def test_a_folder_with_results_of_others_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    project = scene(tmp_path)
    mine = project.folder / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine", encoding="utf-8")
    for more in ((), ("--dry-run",)):
        assert "is not a run folder" in refused(capsys, *arguments(project, project.folder, *more))
    assert mine.read_text(encoding="utf-8") == "mine"


def test_models_of_a_run_are_tested_on_its_test_photos(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run, out = scene(tmp_path), tmp_path / "run", tmp_path / "out"
    assert main([*arguments(project, run), "--seed", "3"]) == 0
    command = ["evaluate", str(project.folder), "--roi", BOX, "--out", str(out), "--model"]
    models = [
        f"A={run / run_files.RESULT}",
        "--model",
        f"B={stage_of(run, 'scene') / run_files.MODEL}",
    ]
    capsys.readouterr()
    assert main([*command, *models]) == 0
    assert "Testing on the photos of" in capsys.readouterr().err
    table = json.loads((out / run_files.REPORT_DATA).read_text(encoding="utf-8"))
    assert table["test_views"] == split_of(run)
    elsewhere = tmp_path / "copy" / "a" / "b" / "c.ply"
    elsewhere.parent.mkdir(parents=True)
    elsewhere.write_bytes((run / run_files.RESULT).read_bytes())
    assert main([*command, f"A={elsewhere}"]) == 0
    assert "may have been trained on" in capsys.readouterr().err


def test_changed_photos_are_refused_or_trained_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = scene(tmp_path, suffix="bmp"), tmp_path / "run"
    photos = sorted((project.folder / "images").iterdir())
    assert main(arguments(project, run)) == 0
    before = plys(run)
    for path in photos:
        path.touch()
    capsys.readouterr()
    assert main(arguments(project, run)) == 0
    assert "finished in an earlier training" in capsys.readouterr().err
    kept = {path: path.read_bytes() for path in photos}
    for path in photos:  # as many bytes under the same times
        status = path.stat()
        ImageOps.invert(Image.open(path).convert("RGB")).save(path)
        assert path.stat().st_size == status.st_size
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert main(arguments(project, run)) == 2
    errors = [li for li in capsys.readouterr().err.splitlines() if li.startswith("error")]
    assert len(errors) == 1 and "10 photos changed, the first is 0.bmp" in errors[0]
    assert "--update" in errors[0]
    assert plys(run) == before
    assert main(arguments(project, run, "--dry-run")) == 0
    assert "10 photos changed" in capsys.readouterr().out
    assert main(arguments(project, run, "--update")) == 0
    said = capsys.readouterr().err
    assert "finished in an earlier training" not in said and "10 photos changed" in said
    now = plys(run)
    assert all((now.get(name) == data) == ("stages" in name) for name, data in before.items())
    for path, data in kept.items():
        path.write_bytes(data)
    assert main(arguments(project, run, "--update")) == 0
    assert "finished in an earlier training" in capsys.readouterr().err
    again = plys(run)
    assert {name: again[name] for name in before} == before


def selected(project: Project, folder: Path) -> list[str]:
    """The photos of a selection of all candidates in `folder`, best first."""
    words = ["select", str(project.folder), "--roi", BOX, "--count", "9", "--out", str(folder)]
    assert main(words) == 0
    names = json.loads((folder / "thing.json").read_text(encoding="utf-8"))["names"]
    return [str(name) for name in names]


def test_a_selected_photo_that_is_lost_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = scene(tmp_path), tmp_path / "run"
    name = selected(project, tmp_path / "chosen")[0]
    (project.folder / "images" / name).unlink()
    capsys.readouterr()
    words = arguments(project, run, "--selection", str(tmp_path / "chosen"))
    assert main(words) == 0
    assert f"Skipped 1 selected photo of box 'thing', which cannot be used: {name}" in (
        capsys.readouterr().err
    )


def test_a_run_with_selected_and_damaged_photos_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Damaged photos are known only after they are decoded."""
    project, run = scene(tmp_path), tmp_path / "run"
    name = selected(project, tmp_path / "chosen")[0]
    photo = project.folder / "images" / name
    photo.write_bytes(photo.read_bytes()[: photo.stat().st_size // 2] + b"\xff\xd9")
    words = arguments(project, run, "--selection", str(tmp_path / "chosen"))
    assert main(words) == 0
    before = plys(run)
    capsys.readouterr()
    assert main(words) == 0
    assert "finished in an earlier training" in capsys.readouterr().err
    assert plys(run) == before


def test_other_cameras_are_not_called_changed_photos(
    distorted: tuple[Project, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = distorted
    capsys.readouterr()
    assert main(arguments(project, run, "--dry-run")) == 0
    assert "lens distortion" not in capsys.readouterr().out  # it is removed already
    (cameras,) = project.folder.rglob("cameras.txt")
    lines = cameras.read_text(encoding="utf-8").splitlines()
    words = lines[-1].split()
    words[4] = str(float(words[4]) * 1.001)  # the focal length
    cameras.write_text("\n".join([*lines[:-1], " ".join(words)]) + "\n", encoding="utf-8")
    assert main(arguments(project, run)) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "has another run" in error and "photo" not in error


def test_one_changed_photo_is_named(
    distorted: tuple[Project, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = distorted
    path = project.folder / "images/3.jpg"
    ImageOps.invert(Image.open(path)).save(path)
    capsys.readouterr()
    assert main(arguments(project, run)) == 2
    assert "(the photo 3.jpg changed)" in capsys.readouterr().err
    # Nothing was lost by the refusal: the photos of the earlier run are still there.
    assert len(list((run / "cache/undistorted").glob("*.png"))) == 11


def test_undistorted_photos_are_made_again_and_tidied_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = scene(tmp_path, distorted=True), tmp_path / "run"
    assert main(arguments(project, run)) == 0
    made = {path: path.read_bytes() for path in (run / "cache/undistorted").iterdir()}
    assert len(made) == 10
    before = plys(run)
    for path, damage in zip(made, (b"", made[next(iter(made))][:-50], b"text"), strict=False):
        path.write_bytes(damage)
    for stage in run.glob("stages/*/stage.json"):
        stage.unlink()
    for path in (project.folder / "images").iterdir():
        path.touch()
    assert main(arguments(project, run)) == 0
    assert plys(run) == before
    assert {p: p.read_bytes() for p in (run / "cache/undistorted").iterdir()} == made
    assert main(arguments(project, run, "--max-side", "60", "--update")) == 0
    other = list((run / "cache/undistorted").iterdir())
    assert len(other) == 10 and not made.keys() & set(other)


def test_a_run_folder_of_another_version(
    copied: tuple[Project, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its stages know nothing of what is in the photos."""
    project, run = copied
    path = run / run_files.MANIFEST
    record = json.loads(path.read_text(encoding="utf-8"))
    del record["version"], record["contents"]
    path.write_text(json.dumps(record), encoding="utf-8")
    capsys.readouterr()
    for more in ([], ["--dry-run"], ["--update"]):
        assert "made by another version" in refused(capsys, *arguments(project, run, *more))


def test_what_is_wrong_is_said_before_photos_are_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, run = scene(tmp_path / "scene", distorted=True), tmp_path / "run"
    wrong = [str(project.folder), "--roi", "far=90,90,90,91,91,91", "--run-dir", str(run)]
    assert main(["run", *wrong]) == 2
    assert not (run / run_files.CACHE).exists()
    split = tmp_path / "split.json"
    split.write_text('{"test": ["other.png"]}', encoding="utf-8")
    out, ply = tmp_path / "out", tmp_path / "none.ply"
    evaluate = ["evaluate", str(project.folder), "--roi", BOX, "--out", str(out)]
    assert main([*evaluate, "--model", f"A={ply}"]) == 2
    assert not (out / run_files.CACHE).exists()
    assert "none.ply" in capsys.readouterr().err
