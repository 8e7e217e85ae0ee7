"""Photos below a folder, also behind links."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from roigs_engine.errors import SceneError
from roigs_engine.photos.files import PhotoFolder
from roigs_engine.photos.mask_paths import MaskFiles

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")


def names_below(folder: Path) -> list[str]:
    return PhotoFolder(folder).others([])


def written(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


def test_a_linked_folder_counts_once_and_loops_end(tmp_path: Path) -> None:
    images = tmp_path / "images"
    written(images / "a.jpg", tmp_path / "disk/b.jpg")
    for link, target in (("day", "../disk"), ("again", "../disk"), ("me", "."), ("up", "..")):
        (images / link).symlink_to(target, target_is_directory=True)
    written(tmp_path / "not_a_photo_of_it.jpg")
    assert names_below(images) in (["a.jpg", "day/b.jpg"], ["a.jpg", "again/b.jpg"])


def test_a_photo_that_a_model_has_by_another_link_is_no_other(tmp_path: Path) -> None:
    images = tmp_path / "images"
    written(tmp_path / "disk/left/c.jpg", images / "a.jpg")
    (images / "rig").symlink_to(tmp_path / "disk", target_is_directory=True)
    (images / "left").symlink_to(tmp_path / "disk/left", target_is_directory=True)
    assert PhotoFolder(images).others(["rig/left/c.jpg"]) == ["a.jpg"]


@pytest.mark.parametrize(
    "name", ["a\0b/c.jpg", "\0.jpg", "x" * 300 + ".jpg", "d/" * 3000 + "a.jpg", "\ud800/a.jpg"]
)
def test_a_name_that_no_file_can_have_is_that_of_a_missing_photo(tmp_path: Path, name: str) -> None:
    written(tmp_path / "images/a.jpg")
    photos = PhotoFolder(tmp_path / "images")
    assert photos.at(name) is None and photos.find(name) is None
    assert "images has" in photos.missing(name)[0]
    assert MaskFiles(tmp_path / "images").find(name) is None
    assert not PhotoFolder(tmp_path / name)._exists


def test_a_whole_disk_is_no_folder_of_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looking at `/` took minutes, without a line."""
    monkeypatch.setattr("roigs_engine.photos.files.MOST_FILES", 200)
    written(*(tmp_path / f"images/{k}/{k}.txt" for k in range(12)))
    with pytest.raises(SceneError, match="images has more than 200 files or 10 folders"):
        PhotoFolder(tmp_path / "images").others([])
