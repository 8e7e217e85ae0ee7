"""Checks of photos before matching."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image, ImageFilter

from roigs_engine.context import QUIET, Context
from roigs_engine.errors import SceneError, Stopped
from roigs_engine.formats.text import named
from roigs_engine.photos.headers import photo_size
from roigs_engine.reconstruction.photo_checks import Found, camera_groups, look_at, warnings_of
from tests.engine.reconstruction.photo_sets import demo_photos, write_noise


def looked(folder: Path) -> Found:
    files = {path.name: path for path in sorted((folder / "photos").iterdir())}
    return look_at(files, folder / "photos.json", QUIET)


def with_camera(path: Path, model: str, focal: float) -> None:
    photo = Image.open(path)
    tags = photo.getexif()
    tags[0x0110] = model
    tags.get_ifd(0x8769)[0x920A] = focal
    photo.save(path, exif=tags)


def test_copies_and_damaged_photos_are_left_out_and_named(tmp_path: Path) -> None:
    for number in range(3):
        write_noise(tmp_path / f"photos/{number}.png", number, (640, 480))
    (tmp_path / "photos/again.png").write_bytes((tmp_path / "photos/1.png").read_bytes())
    (tmp_path / "photos/text.jpg").write_text("not a photo")
    found = looked(tmp_path)
    assert [photo.name for photo in found.photos] == ["0.png", "1.png", "2.png"]
    assert found.unreadable == ("text.jpg",)
    assert found.copies == {"again.png": "1.png"}
    assert warnings_of(found) == [
        "1 photo cannot be read and is left out: text.jpg.",
        "1 photo is a copy of another and is left out: again.png.",
    ]


def test_forty_equal_photos_are_one(tmp_path: Path) -> None:
    write_noise(tmp_path / "photos/00.png")
    for number in range(1, 40):
        copy = tmp_path / f"photos/{number:02}.png"
        copy.write_bytes((tmp_path / "photos/00.png").read_bytes())
    with pytest.raises(SceneError, match="at least two different photos; 1 can be used"):
        looked(tmp_path)


def test_blurred_and_small_photos_are_named(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for number, path in enumerate(demo_photos("wide/*.jpg", 4)):
        photo = Image.open(path)
        if number == 2:
            photo = photo.filter(ImageFilter.GaussianBlur(3))
        photo.resize((320, 214) if number == 3 else photo.size).save(
            tmp_path / f"photos/{number}.png"
        )
    texts = warnings_of(looked(tmp_path))
    assert any("smaller than 480 px" in text and "3.png" in text for text in texts)
    assert any("less sharp" in text and "2.png" in text for text in texts)


def test_photos_share_a_camera_by_size_device_and_focal_length(tmp_path: Path) -> None:
    for number in range(6):
        size = (200, 300) if number == 5 else (300, 200)
        write_noise(tmp_path / f"photos/{number}.jpg", number, size)
    for number, focal in ((1, 24.0), (2, 24.0), (3, 50.0)):
        with_camera(tmp_path / f"photos/{number}.jpg", "Camera", focal)
    photos = looked(tmp_path).photos

    def groups(cameras: str) -> list[str]:
        return ["".join(p.name[0] for p in group) for group in camera_groups(photos, cameras)]

    assert groups("auto") == ["04", "12", "3", "5"]
    assert groups("one") == ["01234", "5"]
    assert groups("each") == list("012345")


def test_long_lists_of_names_are_cut() -> None:
    assert named(list("abcdef")) == "a, b, c, d and 2 more"


def test_a_stop_between_the_sizes_of_photos_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(4):
        write_noise(tmp_path / f"photos/{number}.png", number, (64, 48))
    looked_at: list[Path] = []

    def size(path: Path) -> tuple[int, int]:
        looked_at.append(path)
        return photo_size(path)

    monkeypatch.setattr("roigs_engine.reconstruction.photo_checks.photo_size", size)
    files = {path.name: path for path in sorted((tmp_path / "photos").iterdir())}
    with pytest.raises(Stopped):
        look_at(files, tmp_path / "photos.json", Context(should_stop=lambda: bool(looked_at)))
    assert len(looked_at) == 1
