"""COLMAP projects with damaged or missing files."""

from __future__ import annotations

import contextlib
import random
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.colmap import model_files
from roigs_engine.colmap.model_files import read_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET
from roigs_engine.errors import SceneError
from tests.engine.synthetic_colmap import write_project


def test_missing_folders_and_files(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="is not a folder"):
        load_colmap(tmp_path / "nothing")
    with pytest.raises(SceneError, match="has no COLMAP model"):
        load_colmap(tmp_path)
    write_project(tmp_path)
    (tmp_path / "sparse/0/points3D.bin").unlink()
    with pytest.raises(SceneError, match=r"points3D\.bin"):
        load_colmap(tmp_path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("binary", [True, False])
def test_damaged_files_never_end_in_a_traceback(tmp_path: Path, stem: str, binary: bool) -> None:
    """Cut, flipped and overwritten files load or raise a SceneError, at once."""
    write_project(tmp_path, names=["a.png"], binary=binary)
    path = tmp_path / "sparse/0" / (stem + (".bin" if binary else ".txt"))
    good, dice = path.read_bytes(), random.Random(stem)
    for kind in range(150):
        bad = bytearray(good)
        at = dice.randrange(len(bad))
        if kind % 3 == 0:
            del bad[at:]
        elif kind % 3 == 1:
            bad[at] ^= 1 << dice.randrange(8)
        else:
            bad[at : at + 8] = bytes(dice.choice((0, 255, 31)) for _ in range(8))
        path.write_bytes(bad)
        with contextlib.suppress(SceneError):
            load_colmap(tmp_path)


def test_scenes_of_no_size(tmp_path: Path) -> None:
    """Trained without a word at 1e-60 of their size, to a picture of nothing."""
    write_project(tmp_path, binary=False)
    for stem, numbers in (("images", slice(5, 8)), ("points3D", slice(1, 4))):
        path = tmp_path / f"sparse/0/{stem}.txt"
        lines = path.read_text(encoding="utf-8").splitlines()
        for k, line in enumerate(lines):
            words = line.split()
            if not line.startswith("#") and (stem != "images" or line.endswith(".png")):
                words[numbers] = [f"{float(word) * 1e-60:g}" for word in words[numbers]]
                lines[k] = " ".join(words)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"The cameras span .*e-60 units"):
        load_colmap(tmp_path, pixels=False)


@pytest.mark.parametrize("focal", ["0", "-100", "5e-324", "1e-10", "nan"])
def test_focal_lengths_that_no_lens_has(tmp_path: Path, focal: str) -> None:
    write_project(tmp_path, binary=False)
    path = tmp_path / "sparse/0/cameras.txt"
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    for words in lines:
        if words and words[0] != "#":
            words[4] = focal
    path.write_text("\n".join(map(" ".join, lines)) + "\n", encoding="utf-8")
    with pytest.raises(SceneError, match="camera with parameters"):
        load_colmap(tmp_path, pixels=False)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_every_cut_of_a_binary_file_is_noticed(tmp_path: Path, stem: str) -> None:
    write_project(tmp_path, names=["a.png"], points=np.zeros((2, 3)))
    path = tmp_path / "sparse/0" / f"{stem}.bin"
    good = path.read_bytes()
    for length in range(len(good)):
        path.write_bytes(good[:length])
        with pytest.raises(SceneError, match=f"{stem}\\.bin"):
            read_model(path.parent)


def test_a_text_model_is_not_read_whole_into_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 MB of short lines took 3 GB."""
    monkeypatch.setattr(model_files, "ROWS_AT_ONCE", 1000)
    data = b"".join(b"%d 1 0 0 0 0 0 0 %d 0\n" % (k, k) for k in range(10_000))
    tracemalloc.start()
    ids, points, _, rows, viewers = model_files._text_points(data, True, QUIET)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert ids.tolist() == rows.tolist() == viewers.tolist() == [*range(10_000)]
    assert (points == (1, 0, 0)).all() and most < 8 * len(data)


def test_a_line_of_a_text_model_that_is_far_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_files, "MOST_LINE", 1 << 20)
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.jpg\n" + "1 " * (1 << 20))
    (tmp_path / "cameras.txt").touch()
    (tmp_path / "points3D.txt").touch()
    with pytest.raises(SceneError, match="a line has 2 MB"):
        model_files.read_images(tmp_path)
