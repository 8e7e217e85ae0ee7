"""Pictures of photos as training sees them, and which photos need one."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.colmap.shown_photo import is_as_stored
from tests.engine.colmap.distorted import distorted
from tests.engine.commands.command_line import refused


def test_export_names_the_lens_of_a_distorted_photo(tmp_path: Path) -> None:
    folder = distorted(tmp_path / "scene").folder
    assert main(["export", str(folder), "--out", str(tmp_path / "out")]) == 0
    (image,) = json.loads((tmp_path / "out/scene.json").read_text("utf-8"))["images"]
    assert image["distorted"] and not image["as_stored"] and image["turn"] == 1
    out = tmp_path / "shown.jpg"
    command = ["show-photo", image["path"], "--lens", image["lens"], "--out", str(out)]
    assert main(command) == 0
    with Image.open(out) as shown:
        assert shown.size == (image["width"], image["height"])
    assert main([*command, "--max-side", "100"]) == 0
    with Image.open(out) as small:
        assert max(small.size) == 100


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="has no pipes among files")
@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_a_pipe_is_refused_without_waiting(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / f"a.{suffix}"
    os.mkfifo(pipe)
    line = refused(capsys, "show-photo", pipe, "--out", tmp_path / "b.jpg")
    assert f"Cannot read photo {pipe} (Not a file)." in line


def test_a_photo_is_shown_upright(tmp_path: Path) -> None:
    pixels = np.zeros((40, 60, 3), np.uint8)
    pixels[:, 30:] = 200
    Image.fromarray(pixels).save(tmp_path / "a.png")
    out = tmp_path / "b.jpg"
    assert main(["show-photo", str(tmp_path / "a.png"), "--turn", "6", "--out", str(out)]) == 0
    with Image.open(out) as shown:
        found = np.asarray(shown).astype(int)
    assert found.shape == (60, 40, 3)
    assert found[10].max() < 20 and found[50].min() > 180  # what was right is below


def test_which_photos_need_no_picture(tmp_path: Path) -> None:
    grey = Image.new("RGB", (32, 24), (90, 90, 90))
    as_stored = ("a.jpg", "a.png", "a.tif", "a.bmp")
    for name in as_stored:
        grey.save(tmp_path / name)
    grey.save(tmp_path / "linear.png", pnginfo=_gamma(1.0))
    grey.convert("CMYK").save(tmp_path / "print.jpg")
    grey.convert("CMYK").save(tmp_path / "print.tif")
    Image.fromarray(np.zeros((24, 32), np.uint16)).save(tmp_path / "deep.tif")
    grey.save(tmp_path / "a.ppm")
    found = {file.name: is_as_stored(file) for file in tmp_path.iterdir()}
    assert {name for name, same in found.items() if same} == set(as_stored)
    assert is_as_stored(tmp_path / "missing.jpg")


def test_a_tiff_that_pillow_does_not_read_needs_a_picture(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    planes = np.zeros((3, 24, 32), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", planes, photometric="rgb", planarconfig="separate")
    assert not is_as_stored(tmp_path / "a.tif")


def _gamma(value: float) -> object:
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add(b"gAMA", round(value * 100_000).to_bytes(4, "big"))
    return info


def test_what_cannot_be_shown_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo, out = tmp_path / "a.jpg", tmp_path / "b.jpg"
    Image.new("RGB", (32, 24)).save(photo)
    for lens in ("OPENCV", "OPENCV 32 24 1 2 3", "NO_LENS 32 24 30 30 16 12", "PINHOLE a b"):
        assert "is no camera" in refused(capsys, "show-photo", photo, "--lens", lens, "--out", out)
    assert "is an input" in refused(capsys, "show-photo", photo, "--out", photo)
    assert "missing.jpg" in refused(capsys, "show-photo", tmp_path / "missing.jpg", "--out", out)
    photo.write_bytes(photo.read_bytes()[:100])
    assert "a.jpg" in refused(capsys, "show-photo", photo, "--out", out)
    assert not out.exists()
