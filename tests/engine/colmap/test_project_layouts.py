"""Projects as other software lays them out: found, or one line that says what is wrong."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.colmap.model_files import HINT_DAMAGED
from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.records import relative_names
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.projects import refined_folder
from tests.engine.synthetic_colmap import assert_same, camera, write_project

NAMES = ("a.png", "b.png", "c.png")


def rename_in_model(project: Path, name: Callable[[str], str]) -> None:
    """Give the photos of a text model other names; the files stay."""
    path = project / "sparse/0/images.txt"
    text = path.read_text()
    for each in NAMES:
        text = text.replace(f" {each}\n", f" {name(each)}\n")
    path.write_text(text)


# --- names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "folder", ["/data/photos/", "C:\\photos\\", "\\\\host\\photos\\", "../images/", "D:/x/../y/"]
)
def test_names_of_another_machine(tmp_path: Path, folder: str) -> None:
    project = write_project(tmp_path, names=NAMES, binary=False)
    rename_in_model(tmp_path, lambda name: folder + name)
    assert_same(load_colmap(tmp_path), project)


@pytest.mark.parametrize("folder", ["images/", "sub/", "sub\\", "x/y/"])
def test_photos_in_other_folders_than_the_model_says(tmp_path: Path, folder: str) -> None:
    write_project(tmp_path, names=NAMES, binary=False)
    rename_in_model(tmp_path, lambda name: folder + name)
    found = load_colmap(tmp_path).images
    assert [image.path.name for image in found] == list(NAMES)


def test_absolute_names_keep_the_folders_of_cameras(tmp_path: Path) -> None:
    names = ["left/1.png", "right/1.png"]
    project = write_project(tmp_path, names=names)
    images = tmp_path / "sparse/0/images.bin"
    data = images.read_bytes()
    for name in names:
        data = data.replace(name.encode(), b"/data/rig/" + name.encode())
    images.write_bytes(data)
    assert_same(load_colmap(tmp_path), project, names)
    (tmp_path / "images/left/1.png").unlink()  # the other 1.png is not taken for it
    assert load_colmap(tmp_path).skipped == {"missing on disk": ("left/1.png",)}


def test_a_missing_photo_is_not_replaced_by_one_of_its_name(tmp_path: Path) -> None:
    write_project(tmp_path, names=["one/a.png", "one/b.png"])
    (tmp_path / "images/two").mkdir()
    (tmp_path / "images/one/b.png").rename(tmp_path / "images/two/b.png")
    assert load_colmap(tmp_path).skipped["missing on disk"] == ("one/b.png",)


def test_names_are_shortened_only_if_all_lead_elsewhere() -> None:
    assert relative_names(["/x/a.jpg", "b.jpg"]) == ["/x/a.jpg", "b.jpg"]
    assert relative_names(["/x/a/1.jpg", "/x/b/1.jpg"]) == ["a/1.jpg", "b/1.jpg"]
    assert relative_names(["a:b.jpg"]) == ["a:b.jpg"]
    assert relative_names([]) == []


# --- folders --------------------------------------------------------------------------------------


@pytest.mark.parametrize("inner", ["colmap", "undistorted", "dense/0", "dense", "distorted"])
@pytest.mark.parametrize("beside", [True, False])
def test_models_below_the_project(tmp_path: Path, inner: str, beside: bool) -> None:
    """As nerfstudio (`colmap/sparse/0` beside `images`) and COLMAP's undistorter have them."""
    photos = "images" if beside else f"{inner}/images"
    project = write_project(tmp_path, model=f"{inner}/sparse/0", images=photos)
    for given in (tmp_path, tmp_path / inner, tmp_path / inner / "sparse/0", tmp_path / photos):
        assert_same(load_colmap(given), project)
    assert refined_folder(tmp_path) == refined_folder(tmp_path / inner / "sparse/0")


def test_a_model_of_the_project_itself_is_preferred(tmp_path: Path) -> None:
    project = write_project(tmp_path)
    write_project(tmp_path, names=["a.png"], model="dense/0/sparse", images="dense/0/images")
    assert_same(load_colmap(tmp_path), project)


@pytest.mark.parametrize("model", ["sparse/0", "."])
def test_photos_beside_the_model_files(tmp_path: Path, model: str) -> None:
    project = write_project(tmp_path, model=model, images=model)
    assert_same(load_colmap(tmp_path), project)


def test_smaller_photos_are_mentioned(tmp_path: Path) -> None:
    write_project(tmp_path, images="images_2")
    events: list[Event] = []
    load_colmap(tmp_path, context=Context(emit=events.append))
    assert any("images_2" in e.text for e in events if isinstance(e, Message))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("transforms.json", "colmap/sparse/0"),
        ("database.db", "mapper"),
        ("cameras.xml", "Metashape"),
        ("sparse/0/cameras.bin", "lacks images and points3D"),
    ],
)
def test_folders_without_a_model(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(SceneError, match="has no COLMAP model") as caught:
        load_colmap(tmp_path)
    assert said in str(caught.value)


# --- photos that do not fit -----------------------------------------------------------------------


def too_large(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 20_000, 15_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    path.write_bytes(data)


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def as_broken_link(path: Path) -> None:
    path.unlink()
    path.symlink_to("gone.png")


REASONS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "another shape": (
        lambda path: Image.new("RGB", (50, 50)).save(path),
        ("50 x 50 pixels", "96 x 72", "--images"),
    ),
    "on its side": (
        lambda path: Image.new("RGB", (72, 96)).save(path),
        ("72 x 96 pixels", "96 x 72", "on their side"),
    ),
    "HEIC": (
        lambda path: path.write_bytes(b"\0\0\0\x18ftypheic" + bytes(40)),
        ("HEIC, is not supported", "Convert"),
    ),
    "HEIC beside": (
        lambda path: path.rename(path.with_suffix(".HEIC")),
        ("a.HEIC' instead of 'a.png'", "Convert"),
    ),
    "other format": (
        lambda path: path.rename(path.with_suffix(".jpg")),
        ("a.jpg' instead of 'a.png'", "Convert"),
    ),
    "too large": (too_large, ("20000 x 15000 pixels: more than 178 million", "smaller")),
    "no picture": (lambda path: path.write_text("hello"), ("is no picture", "Restore")),
    "empty": (lambda path: path.write_bytes(b""), ("the file is empty", "Restore")),
    "Git LFS": (
        lambda path: path.write_text("version https://git-lfs.github.com/spec/v1\n"),
        ("git lfs pull",),
    ),
    "folder": (as_folder, ("a.png is a folder", "--images")),
    "broken link": (as_broken_link, ("link to a missing file", "Restore")),
    "ambiguous": (
        lambda path: (
            [
                (path.parent / name).mkdir(exist_ok=True)
                or (path.parent / name / path.name).write_bytes(path.read_bytes())
                for name in ("x", "y")
            ]
            and path.unlink()
        ),
        ("has 'x/a.png' and 'y/a.png', but no 'a.png'", "--images"),
    ),
}


@pytest.mark.parametrize("reason", REASONS)
def test_each_reason_says_what_to_do(tmp_path: Path, reason: str) -> None:
    write_project(tmp_path, names=NAMES)
    change, said = REASONS[reason]
    for name in NAMES:
        change(tmp_path / "images" / name)
    with pytest.raises(SceneError) as caught:
        load_colmap(tmp_path)
    for text in said:
        assert text in str(caught.value)


def test_the_folder_that_has_the_photos_is_named(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES, images="photos")
    with pytest.raises(SceneError, match=r"photos has such photos: give it with --images"):
        load_colmap(tmp_path)


def test_one_photo_of_another_shape_is_described(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    Image.new("RGB", (50, 50)).save(tmp_path / "images/b.png")
    events: list[Event] = []
    load_colmap(tmp_path, context=Context(emit=events.append))
    text = "Skipped 1 photo, wrong size: b.png. b.png has 50 x 50 pixels, its camera 96 x 72"
    assert any(e.text.startswith(text) for e in events if isinstance(e, Message))


# --- cameras --------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["SPHERICAL", "METASHAPE_BROWN", "Panorama"])
def test_text_cameras_of_other_software(tmp_path: Path, model: str) -> None:
    write_project(tmp_path, names=NAMES, binary=False)
    (tmp_path / "sparse/0/cameras.txt").write_text(f"1 {model} 96 72 1 2 3\n")
    with pytest.raises(SceneError, match=f"{model} cameras are not supported") as caught:
        load_colmap(tmp_path)
    assert caught.value.hint != HINT_DAMAGED and "PINHOLE" in str(caught.value)


@pytest.mark.parametrize(("number", "damaged"), [(18, False), (40, False), (-1, True), (999, True)])
def test_binary_cameras_of_newer_software(tmp_path: Path, number: int, damaged: bool) -> None:
    write_project(tmp_path, names=NAMES)
    path = tmp_path / "sparse/0/cameras.bin"
    data = path.read_bytes()
    path.write_bytes(data[:12] + struct.pack("<i", number) + data[16:])
    with pytest.raises(SceneError, match=str(number)) as caught:
        load_colmap(tmp_path)
    assert (caught.value.hint == HINT_DAMAGED) == damaged


@pytest.mark.parametrize("number", [11, 16, 17])
def test_binary_cameras_of_forks(tmp_path: Path, number: int) -> None:
    """SphereSfM's SPHERE has 3 parameters, and the id of a COLMAP model with more."""
    write_project(tmp_path, names=NAMES)
    cameras = b"".join(struct.pack("<IiQQ3d", k, number, 96, 48, 1, 48, 24) for k in (1, 2))
    (tmp_path / "sparse/0/cameras.bin").write_bytes(struct.pack("<Q", 2) + cameras)
    with pytest.raises(SceneError, match="cameras have 3 parameters") as caught:
        load_colmap(tmp_path)
    assert caught.value.hint != HINT_DAMAGED


def test_panoramas_are_not_called_damaged(tmp_path: Path) -> None:
    lens = camera("EQUIRECTANGULAR", width=96, height=48, params=[96.0, 48.0])
    write_project(tmp_path, names=NAMES, cameras=[lens], points=np.ones((3, 3)), tracks=False)
    with pytest.raises(SceneError, match="EQUIRECTANGULAR cannot be undistorted"):
        load_colmap(tmp_path)
