"""`masks`: masks of objects from strokes, on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import BOX, python, refused
from tests.engine.synthetic_colmap import camera, write_project

pytest.importorskip("cv2")
NAMES = ["sub/a.png", "b.png", "c.png", "d.png"]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A project with distorted cameras, a model of a blob, and strokes on the first photo."""
    lens = camera("SIMPLE_RADIAL", params=[100.0, 48.0, 36.0, 0.08])
    folder = write_project(tmp_path / "scene", names=NAMES, cameras=[lens]).folder
    rng = np.random.default_rng(1)
    places = rng.normal(0, 0.12, (800, 3))
    model = Gaussians.from_points(places, np.full(places.shape, 200, np.uint8))
    model.log_scales.fill_(-3.5)
    model.logit_opacities.fill_(3.0)
    model.save_ply(tmp_path / "model.ply")
    write(tmp_path, "thing", NAMES[0])
    return folder


def write(folder: Path, box: str, photo: str) -> Path:
    line = {"kind": "object", "width": 2, "points": [[46, 36], [50, 36]]}
    ring = [[34, 22], [62, 22], [62, 50], [34, 50], [34, 22]]
    strokes = [line, {"kind": "background", "width": 2, "points": ring}]
    path = folder / "strokes.json"
    record = {"scribbles": [{"box": box, "photo": photo, "strokes": strokes}]}
    path.write_text(json.dumps(record))
    return path


def words(scene: Path, out: Path, *more: str) -> list[str]:
    line = ["masks", str(scene), "--roi", BOX, "--device", "cpu", "--out", str(out)]
    return [*line, "--scribbles", str(scene.parent / "strokes.json"), *more]


def test_masks_are_written_for_every_photo_and_cut_reads_them(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, model = tmp_path / "masks", str(tmp_path / "model.ply")
    assert main(words(scene, out, "--model", model)) == 0
    assert "Box 'thing': 4 of 4 masks written" in capsys.readouterr().err
    for name in NAMES:
        mask = np.asarray(Image.open(out / "thing" / f"{name}.png"))
        assert mask.shape == (72, 96) and mask[36, 48] and 40 < mask.sum() < 1500, name
        assert not mask[:5].any() and not mask[:, :5].any()
    line = ["cut", str(scene), "--roi", BOX, "--model", model, "--device", "cpu"]
    assert main([*line, "--masks", str(out), "--out", str(tmp_path / "cut")]) == 0
    assert "by masks on 4 photos" in capsys.readouterr().err


def test_masks_that_need_not_change_are_kept(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, model = tmp_path / "masks", str(tmp_path / "model.ply")
    assert main(words(scene, out, "--model", model, "--photo", "b.png")) == 0
    assert main(words(scene, out, "--model", model, "--photo", "b.png", "--photo", "c.png")) == 0
    assert "1 of 3 masks written" in capsys.readouterr().err
    assert main(words(scene, out, "--photo", "b.png", "--photo", "c.png")) == 0
    assert "3 of 3 masks written" in capsys.readouterr().err
    Image.new("RGB", (96, 72), "blue").save(scene / "images/c.png")
    assert main(words(scene, out, "--photo", "b.png", "--photo", "c.png")) == 0
    assert "1 of 3 masks written" in capsys.readouterr().err


def test_only_the_photos_that_are_asked_for(scene: Path, tmp_path: Path) -> None:
    out, model = tmp_path / "masks", str(tmp_path / "model.ply")
    assert main(words(scene, out, "--model", model, "--photo", "c.png")) == 0
    made = {path.relative_to(out).as_posix() for path in out.rglob("*.png")}
    assert made == {"thing/sub/a.png.png", "thing/c.png.png"}


def test_before_training_no_model_is_needed(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words(scene, tmp_path / "masks")) == 0
    assert "Without --model" in capsys.readouterr().err
    assert len(list((tmp_path / "masks").rglob("*.png"))) == 4


def test_what_cannot_be_done_is_one_line(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "masks"
    write(tmp_path, "other", NAMES[0])
    assert "has no stroke for a box (thing)" in refused(capsys, *words(scene, out))
    write(tmp_path, "thing", "x.png")
    assert "no usable photo 'x.png'" in refused(capsys, *words(scene, out))
    write(tmp_path, "thing", NAMES[0])
    assert "no usable photo 'y.png'" in refused(capsys, *words(scene, out, "--photo", "y.png"))
    line = refused(capsys, *words(scene, out)[:-1], str(tmp_path / "none.json"))
    assert "Cannot read" in line
    far = Gaussians.from_points(np.full((3, 3), 9.0), np.zeros((3, 3), np.uint8))
    far.save_ply(tmp_path / "far.ply")
    assert main(words(scene, out, "--model", str(tmp_path / "far.ply"))) == 2
    assert "no Gaussian in box 'thing'" in capsys.readouterr().err
    assert not out.exists()
    out.write_text("no folder")
    line = refused(capsys, *words(scene, out, "--model", str(tmp_path / "model.ply")))
    assert f"Cannot write {out} (Not a folder)" in line


@pytest.mark.slow
def test_warnings_as_errors_end_neither_masks_nor_cut(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    model = ["--model", str(tmp_path / "model.ply")]
    cut = ["cut", str(scene), "--roi", BOX, "--device", "cpu", "--out", str(tmp_path / "cut")]
    for line in (
        words(scene, tmp_path / "masks", *model),
        [*cut, "--masks", str(tmp_path / "masks"), *model],
    ):
        done = python(*line, cold=True)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr and "Warning:" not in done.stderr
