"""Folders and names of a COLMAP project's model and photos."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import pytest
from PIL import Image

from roigs_engine.colmap.model_files import read_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import assert_same, camera, write_project


@pytest.mark.parametrize("model", ["sparse/0", "sparse", ".", "0"])
def test_model_folders(tmp_path: Path, model: str) -> None:
    project = write_project(tmp_path, model=model)
    assert_same(load_colmap(tmp_path), project)
    assert_same(load_colmap(tmp_path / model), project)
    assert_same(load_colmap(str(tmp_path / model), images=tmp_path / "images"), project)


def test_the_model_with_most_photos_is_taken(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png"], model="sparse/0")
    write_project(tmp_path, names=["a.png", "b.png", "c.png"], model="sparse/1", binary=False)
    write_project(tmp_path, names=["a.png", "b.png"], model="sparse/10")
    events: list[Event] = []
    scene = load_colmap(tmp_path, context=Context(emit=events.append))
    assert len(scene.images) == 3
    texts = [event.text for event in events if isinstance(event, Message)]
    assert any("3 models" in text and "sparse/1 with 3 photos" in text for text in texts)


def test_a_model_that_only_claims_to_have_most_photos_is_not_taken(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "b.png"], model="sparse/0")
    write_project(tmp_path, names=["a.png"], model="sparse/1")
    path = tmp_path / "sparse/1/images.bin"
    path.write_bytes(struct.pack("<Q", 1 << 50) + path.read_bytes()[8:])
    (tmp_path / "sparse/²").mkdir()  # a digit, but no number
    assert len(load_colmap(tmp_path).images) == 2


@pytest.mark.parametrize("params", [(100.0, 0.0, 45, 40), (100.0, -1.0, 45, 40), (1e300, 90, 0, 0)])
def test_cameras_without_a_focal_length(tmp_path: Path, params: tuple[float, ...]) -> None:
    write_project(tmp_path, binary=False)
    line = f"1 PINHOLE 96 72 {' '.join(map(str, params))}\n"
    (tmp_path / "sparse/0/cameras.txt").write_text(line)
    with pytest.raises(SceneError, match=r"cameras\.txt"):
        load_colmap(tmp_path)


def test_reading_takes_memory_as_the_file_has_bytes(tmp_path: Path) -> None:
    count = 100_000
    write_project(tmp_path)
    point = struct.pack("<Q3d3BdQ", 1, 0.1, 0.2, 0.3, 9, 9, 9, 0.5, 0)
    path = tmp_path / "sparse/0/points3D.bin"
    path.write_bytes(struct.pack("<Q", count) + count * point)
    tracemalloc.start()
    assert len(read_model(path.parent).points) == count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * path.stat().st_size + (8 << 20)


@pytest.mark.parametrize("binary", [True, False])
def test_names_in_any_script(tmp_path: Path, binary: bool) -> None:
    names = ["a b/with space.png", "[x] (1).png", "くまモン/写真 一.png", "déjà.png", "a.b/c.d.png"]
    folder = tmp_path / "projet été [1]"
    project = write_project(folder, names=names, binary=binary)
    assert_same(load_colmap(folder), project)


def test_names_that_differ_in_case_slash_or_accents(tmp_path: Path) -> None:
    project = write_project(tmp_path, names=["a.jpg", "sub/b.png", "de\u0301ja\u0300.png"])
    photos = tmp_path / "images"
    (photos / "a.jpg").rename(photos / "a.JPG")
    (photos / "de\u0301ja\u0300.png").rename(photos / "d\u00e9j\u00e0.png")
    images_bin = tmp_path / "sparse/0/images.bin"
    images_bin.write_bytes(images_bin.read_bytes().replace(b"sub/b.png", b"sub\\b.png"))
    scene = load_colmap(tmp_path)
    assert_same(scene, project)
    assert not scene.skipped
    assert (photos / "a.JPG").samefile(scene.image("a.jpg").path)


def test_names_that_lead_out_of_the_folder_find_nothing(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "bb/c.png"])
    (tmp_path / "c.png").write_bytes((tmp_path / "images/a.png").read_bytes())
    images_bin = tmp_path / "sparse/0/images.bin"
    images_bin.write_bytes(images_bin.read_bytes().replace(b"bb/c.png", b"../c.png"))
    assert load_colmap(tmp_path).skipped["missing on disk"] == ("../c.png",)


@pytest.mark.parametrize("folder", ["images_2", "images_4", "images_8"])
def test_reduced_photo_folders(tmp_path: Path, folder: str) -> None:
    factor = int(folder[-1])
    big = camera(width=963, height=721, params=[1000.0, 900.0, 470.0, 400.0])
    write_project(tmp_path, cameras=[big], images=None)
    (tmp_path / "images").mkdir()  # empty: passed over
    (tmp_path / folder).mkdir()
    size = (round(963 / factor), 721 // factor)
    for name in "abc":
        Image.new("RGB", size).save(tmp_path / folder / f"{name}.png")
    image = load_colmap(tmp_path).images[0]
    found = image.camera
    assert (found.width, found.height) == size
    assert found.fx == pytest.approx(1000 * size[0] / 963, rel=1e-12)
    assert found.cy == pytest.approx(400 * size[1] / 721, rel=1e-12)
