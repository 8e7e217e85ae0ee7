"""Masks on the command line: used, changed, refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from tests.engine.commands.command_line import BOX, refused
from tests.engine.runs import finished
from tests.engine.synthetic_colmap import write_project

NAMES = [f"{k}.png" for k in range(10)]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write_project(tmp_path / "scene", names=NAMES, dots=True).folder


def put(folder: Path, column: int, names: list[str] = NAMES) -> None:
    """Masks that ignore what is left of a column."""
    mask = np.ones((72, 96), bool)
    mask[:, :column] = False
    folder.mkdir(exist_ok=True)
    for name in names:
        Image.fromarray(mask).save(folder / f"{name}.png")


def command(name: str, scene: Path, run: Path, *more: str) -> list[str]:
    tiny = ["--steps-factor", "0.003", "--test-every", "4", "--device", "cpu"]
    return [name, str(scene), "--roi", BOX, *tiny, "--run-dir", str(run), *more]


def test_a_run_with_masks_and_with_other_masks(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    put(scene / "masks", 30)
    assert main(command("run", scene, run)) == 0
    said = capsys.readouterr()
    assert "10 photos with a mask" in said.err and "photos with a mask" in said.out
    settings = json.loads((run / run_files.SETTINGS).read_text("utf-8"))
    assert not {"masks", "no_masks", "invert_masks"} & settings.keys()
    assert main(command("run", scene, run, "--dry-run")) == 0
    assert capsys.readouterr().out.count(" done\n") == 3
    assert main(command("run", scene, run)) == 0
    assert "scene: finished in an earlier training" in capsys.readouterr().err

    put(scene / "masks", 40, ["3.png"])
    line = refused_after_notes(command("run", scene, run), capsys)
    assert "the mask of 3.png changed" in line and "--update" in line
    assert main(command("run", scene, run, "--update")) == 0
    assert "earlier training" not in capsys.readouterr().err
    assert list((run / run_files.CACHE / run_files.MASKS).glob("*.png"))
    assert main(["clean", str(run)]) == 0
    assert not (run / run_files.CACHE / run_files.MASKS).exists()
    assert main(command("run", scene, run)) == 0


def refused_after_notes(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one error line of a command that says other things before."""
    assert main(words) == 2
    (line,) = [s for s in capsys.readouterr().err.splitlines() if s.startswith("error: ")]
    return line


def test_options_of_masks(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "others", 30)
    run = tmp_path / "run"
    given = ("--masks", str(tmp_path / "others"), "--invert-masks")
    assert main(command("train", scene, run, *given)) == 0
    settings = json.loads((run / run_files.SETTINGS).read_text("utf-8"))
    assert settings["masks"] == str(tmp_path / "others") and settings["invert_masks"] is True
    assert main(["train", str(run / run_files.SETTINGS), "--run-dir", str(run)]) == 0
    assert "joint: finished in an earlier training" in capsys.readouterr().err
    assert main(command("train", scene, tmp_path / "plain")) == 0
    put(scene / "masks", 30)
    assert main(command("train", scene, tmp_path / "none", "--no-masks")) == 0
    results = [(tmp_path / name / run_files.RESULT).read_bytes() for name in ("plain", "none")]
    assert results[0] == results[1] != (run / run_files.RESULT).read_bytes()


def test_masks_that_cannot_be_used(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command("train", scene, tmp_path / "run")
    assert "is not a folder" in refused(capsys, *words, "--masks", tmp_path / "none")
    both = refused(capsys, *words, "--masks", scene, "--no-masks")
    assert "not allowed with" in both
    put(scene / "masks", 30)
    (scene / "masks/3.png.png").write_bytes(b"")
    line = refused_after_notes(words, capsys)
    assert "3.png.png (the file is empty)" in line and "--no-masks" in line


def put_object(
    scene: Path, mask: np.ndarray, names: list[str], folder: str = "masks/thing"
) -> None:
    """Masks of the object of box `thing`."""
    (scene / folder).mkdir(parents=True, exist_ok=True)
    for name in names:
        Image.fromarray(mask).save(scene / folder / f"{name}.png")


def left_half() -> np.ndarray:
    mask = np.zeros((72, 96), bool)
    mask[:, :48] = True
    return mask


def test_a_run_with_masks_of_an_object_and_without(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene / "masks/thing").mkdir(parents=True)  # without a file
    assert main(command("train", scene, tmp_path / "empty")) == 0
    put_object(scene, left_half(), NAMES[::2])
    assert main(command("train", scene, tmp_path / "none", "--no-object-masks")) == 0
    capsys.readouterr()
    assert main(command("run", scene, tmp_path / "run", "--compare")) == 0
    said = capsys.readouterr()
    assert "Box 'thing': masks of the object on 5 photos." in said.err
    assert "mask PSNR (dB)" in said.out and "Joint, cut out" in said.out
    assert "cutout" not in finished(tmp_path / "none") and "cutout" in finished(tmp_path / "run")
    for name in (run_files.RESULT, "rois/thing.ply", "background.ply", "coarse/thing.ply"):
        files = [(tmp_path / run / name).read_bytes() for run in ("empty", "none")]
        assert files[0] == files[1]
    settings = json.loads((tmp_path / "none" / run_files.SETTINGS).read_text("utf-8"))
    assert settings["no_object_masks"] is True
    assert main(command("run", scene, tmp_path / "run", "--compare", "--dry-run")) == 0
    assert capsys.readouterr().out.count(" done\n") == 3
    put_object(scene, ~left_half(), ["4.png"])
    line = refused_after_notes(command("run", scene, tmp_path / "run", "--compare"), capsys)
    assert "box 'thing': the mask of 4.png changed" in line and "--update" in line
    split = str(tmp_path / "run" / run_files.SPLIT)
    words = ["evaluate", str(scene), "--roi", BOX, "--split", split, "--device", "cpu"]
    model = f"Ours={tmp_path / 'run' / run_files.RESULT}"
    assert main([*words, "--model", model, "--out", str(tmp_path / "out")]) == 0
    assert "mask PSNR (dB)" in capsys.readouterr().out


def test_masks_of_objects_in_the_run_folder(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, none = tmp_path / "run", tmp_path / "none"
    put_object(run, left_half(), NAMES[::2], "blender/masks/thing")
    words = command("train", scene, run)
    assert main([*words, "--dry-run"]) == 0
    found = "Box 'thing': masks of the object on 5 photos."
    assert found in capsys.readouterr().err
    assert main(words) == 0
    assert found in capsys.readouterr().err and "cutout" in finished(run)
    select = ["select", str(scene), "--roi", BOX, "--object-masks"]
    assert main([*select, str(run / "blender/masks")]) == 0
    assert found in capsys.readouterr().err
    assert "Give --object-masks" in refused(capsys, *select, none)
    put_object(scene, left_half(), NAMES[1:2])
    assert main([*words, "--dry-run", "--update"]) == 0
    assert "masks of the object on 6 photos" in capsys.readouterr().err
    assert main([*words, "--dry-run", "--update", "--masks", str(scene / "masks")]) == 0
    assert "masks of the object on 1 photo." in capsys.readouterr().err


def test_masks_of_objects_that_cannot_be_used(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put_object(scene, left_half(), NAMES)
    words = command("train", scene, tmp_path / "run")
    for data, reason in ((b"", "the file is empty"), (b"no picture", "it is no PNG")):
        (scene / "masks/thing/3.png.png").write_bytes(data)
        line = refused_after_notes(words, capsys)
        assert f"3.png.png ({reason})" in line and "--no-masks" not in line
    put_object(scene, np.zeros((72, 96), bool), NAMES)
    assert main(words) == 0
    said = capsys.readouterr().err
    assert "Box 'thing': 10 masks show nothing in the box and are not used: 0.png" in said
    assert not (tmp_path / "run/cutout").exists()
    assert main(["select", str(scene), "--roi", BOX]) == 0
    assert "show nothing in the box" in capsys.readouterr().err
