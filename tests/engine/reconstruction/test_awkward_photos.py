"""Formats, tags and names that photos come with, and folders of photos that fit badly."""

from __future__ import annotations

import json
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

from roigs_engine.cli import main
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET
from roigs_engine.errors import SceneError
from roigs_engine.photos.decode import decode
from roigs_engine.photos.exposures import exif_exposure
from roigs_engine.photos.mask_paths import MaskOptions
from roigs_engine.reconstruction.convert import converted
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import look_at
from roigs_engine.reconstruction.reconstruct import find_features, reconstruct
from roigs_engine.requests.projects import Reconstruct
from tests.engine.commands.command_line import refused
from tests.engine.deep_png import write_png16
from tests.engine.reconstruction.photo_sets import copy_photos, demo_photos, write_noise
from tests.icc_profiles import P3_PROFILE

pytest.importorskip("pycolmap")

ORIENTATION = 0x0112


def heif() -> None:
    """Let Pillow write HEIC files, or skip the test."""
    pytest.importorskip("pillow_heif").register_heif_opener()


def turned(photo: Image.Image, path: Path) -> None:
    tags = Image.Exif()
    tags[ORIENTATION] = 6
    photo.save(path, quality=95, exif=tags)


def png16(photo: Image.Image, path: Path) -> None:
    write_png16(path, np.asarray(photo).astype(np.uint16) * 257)


def tiff16(photo: Image.Image, path: Path) -> None:
    Image.fromarray(np.asarray(photo.convert("L")).astype(np.uint16) * 257).save(path)


WRITERS: dict[str, Callable[[Image.Image, Path], None]] = {
    "turned.jpg": turned,
    "turned.png": turned,
    "deep.png": png16,
    "deep.tif": tiff16,
    "cmyk.jpg": lambda photo, path: photo.convert("CMYK").save(path, quality=95),
    "web.webp": turned,
    "wave.jp2": lambda photo, path: photo.save(path),
    "phone.heic": lambda photo, path: (heif(), photo.save(path, quality=95)),
}


def features(folder: Folder, source: Path) -> dict[str, np.ndarray]:
    """Name -> (N, 2) places of the features of the photos below a folder."""
    folder.work().mkdir(parents=True)
    files = converted(folder.photos_of(source), folder, QUIET)
    found = look_at(files, folder.work("photos.json"), QUIET)
    folder.take_photos(list(found.photos))
    request = Reconstruct(photos=source, out=folder.root, features=800, threads=1)
    find_features(folder, found, request, QUIET)
    with closing(sqlite3.connect(folder.database)) as file:
        query = "SELECT name, rows, cols, data FROM images JOIN keypoints USING (image_id)"
        return {
            name: np.frombuffer(data, np.float32).reshape(rows, columns)[:, :2]
            for name, rows, columns, data in file.execute(query)
        }


@pytest.fixture(scope="module")
def photo() -> Image.Image:
    (photo_file,) = demo_photos("wide/*.jpg", 1)
    with Image.open(photo_file) as file:
        return file.convert("RGB").reduce(2)


@pytest.fixture(scope="module")
def found(
    photo: Image.Image, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Folder, dict[str, np.ndarray]]:
    """The features of a photo in each form."""
    top = tmp_path_factory.mktemp("forms")
    (top / "photos").mkdir()
    photo.save(top / "photos/plain.png")
    for name, write in WRITERS.items():
        with suppress(pytest.skip.Exception):  # the test of that form says it
            write(photo, top / "photos" / name)
    folder = Folder(top / "scene")
    return folder, features(folder, top / "photos")


@pytest.mark.parametrize("name", WRITERS)
def test_pycolmap_and_training_see_the_same_pixels(
    photo: Image.Image, found: tuple[Folder, dict[str, np.ndarray]], name: str
) -> None:
    """Features lie where the pixels of the photo lie that training decodes."""
    if name.endswith(".heic"):
        heif()
    folder, places = found
    used = next(key for key in places if key.startswith(name))
    here, plain = decode(folder.images / used), np.asarray(photo)
    assert here.shape == plain.shape
    grey = [pixels.mean(axis=2).ravel() for pixels in (here, plain)]
    assert np.corrcoef(*grey)[0, 1] > 0.98
    gaps = np.linalg.norm(places[used][:, None] - places["plain.png"][None], axis=2).min(axis=1)
    assert (gaps < 1).mean() > 0.75
    assert np.median(gaps) < 0.3


def test_photos_of_phones_keep_their_camera(tmp_path: Path) -> None:
    heif()
    (photo_file,) = demo_photos("wide/*.jpg", 1)
    (tmp_path / "photos").mkdir()
    with Image.open(photo_file) as photo:
        tags = photo.getexif()
        tags[0x0110], tags[ORIENTATION] = "Phone", 1
        photo.save(tmp_path / "photos/IMG 1.HEIC", exif=tags)
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    for _ in range(2):
        files = converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)
        assert files == {"IMG 1.HEIC.jpg": folder.images / "IMG 1.HEIC.jpg"}
    with Image.open(folder.images / "IMG 1.HEIC.jpg") as photo:
        assert photo.getexif()[0x0110] == "Phone" and ORIENTATION not in photo.getexif()
    folder.work("converted.json").unlink()  # killed before it was written
    before = (folder.images / "IMG 1.HEIC.jpg").stat().st_mtime_ns
    assert converted(folder.photos_of(tmp_path / "photos"), folder, QUIET) == files
    assert (folder.images / "IMG 1.HEIC.jpg").stat().st_mtime_ns == before
    write_noise(tmp_path / "photos/IMG 1.png")
    (tmp_path / "photos/IMG 1.png").unlink()
    Image.new("RGB", (640, 480)).save(tmp_path / "photos/IMG 1.HEIC")
    with pytest.raises(SceneError, match="exists and is not"):
        converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)


@pytest.mark.parametrize("needed", [True, False])
def test_long_exif_data_are_no_reason_to_lose_a_photo(tmp_path: Path, needed: bool) -> None:
    """A JPEG has room for 64 kB of them."""
    (tmp_path / "photos").mkdir()
    exif = Image.Exif()
    exif[0x0110] = "Phone"
    exif[0x8769] = {0x829A: 0.25, 0x8827: 100, 0x927C: b"x" * 70_000}
    if not needed:  # too long without the maker's notes, too
        exif[0x8825] = {0x001C: b"x" * 70_000}
    Image.new("RGB", (64, 48)).save(tmp_path / "photos/a.webp", exif=exif)
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    files = converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)
    assert list(files) == ["a.webp.jpg"]
    assert decode(files["a.webp.jpg"]).shape == (48, 64, 3)
    assert exif_exposure(files["a.webp.jpg"]) == (-2 if needed else None)
    with Image.open(files["a.webp.jpg"]) as photo:
        assert photo.getexif().get(0x0110) == ("Phone" if needed else None)


def test_photos_that_become_jpeg_become_srgb(tmp_path: Path) -> None:
    """Also those that an earlier version has converted without their profile."""
    heif()
    (tmp_path / "photos").mkdir()
    exif = Image.Exif()
    exif[0x8769] = {0xA001: 0xFFFF, 0xA005: {1: "R03"}}  # would be Adobe RGB
    for name in ("a.HIF", "b.webp"):
        pixels = Image.new("RGB", (64, 48), (187, 57, 48))  # 200, 40, 40 in sRGB
        kind = "WEBP" if name.endswith("webp") else "HEIF"
        pixels.save(
            tmp_path / "photos" / name, kind, icc_profile=P3_PROFILE, exif=exif, quality=100
        )
    pixels.save(
        tmp_path / "photos/c.heic", quality=100, color_primaries=12, transfer_characteristics=13
    )
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    for _ in range(2):
        files = converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)
        assert len(files) == 3
        for path in files.values():
            assert np.abs(decode(path)[20, 30].astype(int) - (200, 40, 40)).max() <= 4
        record = json.loads(folder.work("converted.json").read_text())
        old = {name: value.split()[0] for name, value in record.items()}
        folder.work("converted.json").write_text(json.dumps(old))
        Image.new("RGB", (64, 48)).save(files["a.HIF.jpg"])


def test_heic_in_the_project_itself(tmp_path: Path) -> None:
    heif()
    folder = Folder(tmp_path)
    folder.images.mkdir()
    folder.work().mkdir()
    Image.effect_noise((64, 48), 50).convert("RGB").save(folder.images / "a.heic")
    for _ in range(2):
        assert set(converted(folder.photos_of(folder.images), folder, QUIET)) == {"a.heic.jpg"}


def test_a_missing_pillow_heif_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/a.heic").write_bytes(b"any")
    line = refused(capsys, "reconstruct", tmp_path / "photos", "--out", tmp_path / "scene")
    assert "1 photo in HEIC format" in line and "pip install pillow-heif" in line


def test_a_damaged_photo_of_another_format_is_left_out(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    for number in range(2):
        write_noise(tmp_path / f"photos/{number}.png", number)
    write_noise(tmp_path / "photos/whole.webp", 3)
    whole = (tmp_path / "photos/whole.webp").read_bytes()
    (tmp_path / "photos/cut.webp").write_bytes(whole[: len(whole) // 2])
    files = converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)
    found = look_at(files, folder.work("photos.json"), QUIET)
    assert found.unreadable == ("cut.webp",)
    assert [photo.name for photo in found.photos] == ["0.png", "1.png", "whole.webp.jpg"]


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_photos_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], count: int
) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/text.jpg").write_text("this is text")
    for number in range(count):
        write_noise(tmp_path / f"photos/{number}.png", number)
    words = ["reconstruct", tmp_path / "photos", "--out", tmp_path / "scene"]
    assert main([str(word) for word in words]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert f"at least two different photos; {count} can be used (1 unreadable" in line


def test_two_photos_give_a_model_or_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["a b.jpg", "写真 ü.jpg"]
    copy_photos(tmp_path / "photos", demo_photos("wide/*.jpg", 2), names, 0.6)
    words = ["reconstruct", tmp_path / "photos", "--out", tmp_path / "scene", "--features", 1000]
    status = main([str(word) for word in words])
    said = capsys.readouterr().err
    assert status in (0, 2) and "Traceback" not in said
    assert (tmp_path / "scene/reconstruction.md").exists()
    if status == 0:
        assert "Only two photos could be registered" in said
        assert len(load_colmap(tmp_path / "scene", pixels=False).images) == 2
    else:
        assert "No two photos could be registered" in said.splitlines()[-1]


@pytest.mark.slow
def test_photos_of_two_scenes_are_told_apart(tmp_path: Path) -> None:
    """One of them has 17 matches with the other scene by chance."""
    copy_photos(tmp_path / "photos", demo_photos("wide/*.jpg", 8), [f"a{k}.jpg" for k in range(8)])
    for number, path in enumerate(demo_photos("close/clock*.jpg", 6)):
        with Image.open(path) as photo:  # a mirrored place is another place
            ImageOps.mirror(photo).save(tmp_path / f"photos/b{number}.jpg", quality=95)
    photos, out = tmp_path / "photos", tmp_path / "scene"
    request = Reconstruct(photos=photos, out=out, features=3000, threads=2)
    reconstruct(request, MaskOptions(), QUIET)
    names = {image.name[0] for image in load_colmap(tmp_path / "scene", pixels=False).images}
    assert len(names) == 1
    report = (tmp_path / "scene/reconstruction.md").read_text("utf-8")
    assert "form a model of their own" in report
