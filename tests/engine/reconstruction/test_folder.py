"""The folder of a reconstruction: what it takes, and what it never replaces."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.context import QUIET
from roigs_engine.errors import RunFolderError, SceneError
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import Photo, look_at
from tests.engine.exchanged_models import grown
from tests.engine.killing import killed_everywhere
from tests.engine.reconstruction.photo_sets import write_noise


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    for number in range(3):
        write_noise(tmp_path / f"photos/sub/{number}.png", number)
    return tmp_path / "photos"


def looked(folder: Folder, source: Path) -> list[Photo]:
    found = look_at(folder.photos_of(source), folder.work("photos.json"), QUIET)
    return list(found.photos)


def test_photos_are_taken_with_their_folders_and_only_once(photos: Path, tmp_path: Path) -> None:
    folder = Folder(tmp_path / "scene")
    for _ in range(2):
        folder.take_photos(looked(folder, photos))
        assert len(list(folder.images.rglob("*.png"))) == 3
    source, taken = photos / "sub/1.png", folder.images / "sub/1.png"
    assert taken.read_bytes() == source.read_bytes() and not taken.is_symlink()


def test_photos_that_cannot_be_linked_are_copied(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*names: object) -> None:
        raise OSError

    monkeypatch.setattr("os.link", no_links)
    folder = Folder(tmp_path / "scene")
    found = looked(folder, photos)
    folder.take_photos(found)
    assert (folder.images / "sub/1.png").read_bytes() == (photos / "sub/1.png").read_bytes()
    assert len(looked(folder, folder.images)) == 3


def test_another_photo_of_that_name_is_not_replaced(photos: Path, tmp_path: Path) -> None:
    folder = Folder(tmp_path / "scene")
    write_noise(folder.images / "sub/1.png", 7)
    before = (folder.images / "sub/1.png").read_bytes()
    with pytest.raises(SceneError, match="exists and is not"):
        folder.take_photos(looked(folder, photos))
    assert (folder.images / "sub/1.png").read_bytes() == before


def test_a_scene_in_the_folder_of_photos_is_not_read_as_photos(photos: Path) -> None:
    folder = Folder(photos)
    folder.take_photos(looked(folder, photos))
    assert [photo.name for photo in looked(folder, photos)] == [f"sub/{n}.png" for n in range(3)]


def test_a_foreign_model_is_refused(tmp_path: Path) -> None:
    model = tmp_path / "sparse/0"
    model.mkdir(parents=True)
    for name in ("cameras.bin", "images.bin"):
        (model / name).write_bytes(b"theirs")
    folder = Folder(tmp_path)
    with pytest.raises(SceneError, match="has a model already"), folder.held(QUIET.warn):
        pass


@pytest.mark.parametrize("place", ["database.db", "database.db-wal", "reconstruction/models"])
def test_what_others_made_is_refused(tmp_path: Path, place: str) -> None:
    theirs = tmp_path / place
    theirs.parent.mkdir(exist_ok=True)
    theirs.write_bytes(b"theirs")
    folder = Folder(tmp_path)
    with pytest.raises(SceneError, match="not created by this command"), folder.held(QUIET.warn):
        pass
    assert theirs.read_bytes() == b"theirs"
    assert [path.name for path in tmp_path.iterdir()] == [Path(place).parts[0]]


FOLDERS = ("sparse", "sparse/0", "images", "reconstruction")
OWN = ("models", "models/first", "models/second", "snapshots", "earlier", "earlier/0", "masks")
FILES = ("database.db", "database.db-wal", "database.db-journal", "reconstruction/log.txt")


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
@pytest.mark.parametrize(
    "place", [*FOLDERS, *(f"reconstruction/{name}" for name in OWN), *FILES], ids=str
)
def test_nothing_is_written_through_a_link(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    out, outside = tmp_path / "scene", tmp_path / "outside"
    outside.mkdir()
    theirs = outside / "theirs"
    theirs.write_bytes(b"")
    Folder(out).begin(looked(Folder(out), photos), {})
    if place == "reconstruction":
        (out / place).rename(outside / place)
    (out / place).parent.mkdir(parents=True, exist_ok=True)
    (out / place).symlink_to(theirs if place in FILES else outside, place not in FILES)
    before = {path: path.stat().st_mtime_ns for path in (outside, *outside.rglob("*"))}
    words = ("reconstruct", photos, "--out", out, "--features", 300)
    assert main([str(word) for word in words]) == 2
    assert f"{out / place} is a link" in capsys.readouterr().err.splitlines()[-1]
    assert before == {path: path.stat().st_mtime_ns for path in (outside, *outside.rglob("*"))}


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
def test_copies_of_photos_are_not_written_through_links(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*names: object) -> None:
        raise OSError

    monkeypatch.setattr("os.link", no_links)
    folder, theirs = Folder(tmp_path / "scene"), tmp_path / "theirs"
    theirs.write_bytes(b"theirs")
    (folder.images / "sub").mkdir(parents=True)
    (folder.images / "sub/.1.png.part").symlink_to(theirs)
    folder.take_photos(looked(folder, photos))
    assert theirs.read_bytes() == b"theirs" and (folder.images / "sub/1.png").is_file()


def test_another_engine_in_the_folder_is_one_line(tmp_path: Path) -> None:
    first, second = Folder(tmp_path), Folder(tmp_path)
    with first.held(QUIET.warn), pytest.raises(RunFolderError) as error, second.held(QUIET.warn):
        pass
    assert "Another engine is at work" in error.value.message
    assert "choose another folder (--out)" in error.value.hint


def test_changed_settings_and_photos_begin_again(photos: Path, tmp_path: Path) -> None:
    folder, features = Folder(tmp_path / "scene"), {"max_side": 1600, "masks": {"a.png": "1f"}}
    found = looked(folder, photos)
    assert folder.begin(found, features) == ""
    folder.database.write_bytes(b"features")
    assert folder.begin([*found[:2], replace(found[2], name="new.png")], features)
    assert not folder.database.exists()
    folder.begin(found[:2], features)
    folder.database.write_bytes(b"features")
    assert folder.begin(found, features) == ""
    assert folder.database.exists()
    assert "settings changed" in folder.begin(found, features | {"masks": {}})
    assert not folder.database.exists()


@pytest.mark.parametrize("known", [None, 7, [7], "x", {"a": []}])
def test_a_damaged_record_begins_again(photos: Path, tmp_path: Path, known: object) -> None:
    folder = Folder(tmp_path / "scene")
    found = looked(folder, photos)
    folder.begin(found, {})
    folder.database.write_bytes(b"features")
    record = folder.work("state.json")
    record.write_text(json.dumps(json.loads(record.read_text("utf-8")) | {"photos": known}))
    assert "features are found again" in folder.begin(found, {})


def test_an_earlier_result_is_kept(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.work().mkdir()
    for number in range(3):
        source = folder.work(f"found-{number}")
        source.mkdir()
        (source / "points3D.bin").write_text(str(number))
        folder.take_model(source)
    assert (folder.model / "points3D.bin").read_text() == "2"
    assert (folder.work("earlier", "0", "points3D.bin")).read_text() == "0"
    assert (folder.work("earlier", "1", "points3D.bin")).read_text() == "1"


def test_an_earlier_result_that_the_user_deleted_is_no_hindrance(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    for number in range(4):
        source = folder.work(f"found-{number}")
        source.mkdir(parents=True)
        (source / "points3D.bin").write_text(str(number))
        if number == 3:
            shutil.rmtree(folder.work("earlier", "0"))
        folder.take_model(source)
    kept = {path.parent.name: path.read_text() for path in folder.work("earlier").rglob("*.bin")}
    assert kept == {"0": "2", "1": "1"} and (folder.model / "points3D.bin").read_text() == "3"


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
def test_photos_behind_links_are_found_once(photos: Path, tmp_path: Path) -> None:
    """Links into the folder, to a folder above it, and to the reconstruction's own photos."""
    write_noise(tmp_path / "disk/tour/3.png", 3)
    (tmp_path / "disk/tour/back").symlink_to(photos)
    (photos / "a").symlink_to(photos / "sub")
    (photos / "far").symlink_to(tmp_path / "disk")
    (photos / "nowhere").symlink_to(tmp_path / "none")
    (photos / "sub/loop").symlink_to(photos / "sub")
    (photos / "up").symlink_to(photos.parent)
    folder = Folder(tmp_path / "scene")
    (photos / "own").symlink_to(folder.images)
    for _ in range(2):
        found = looked(folder, photos)
        names = [photo.name for photo in found]
        assert names == ["far/tour/3.png", "sub/0.png", "sub/1.png", "sub/2.png"]
        folder.take_photos(found)
    assert (folder.images / "far/tour/3.png").read_bytes()
    assert not [path for path in folder.images.rglob("*") if path.is_symlink()]


def test_photos_in_other_formats_are_counted(tmp_path: Path) -> None:
    photos, folder = tmp_path / "photos", Folder(tmp_path / "photos" / "out")
    for name in ("1.NEF", "sub/2.nef", "3.dng", "4.CR2", "4.jpg", "notes.txt", ".5.nef"):
        (photos / name).parent.mkdir(parents=True, exist_ok=True)
        (photos / name).touch()
    (folder.images).mkdir(parents=True)
    (folder.images / "6.nef").touch()
    assert folder.unread_of(photos) == {".NEF": 2, ".DNG": 1}
    assert list(folder.photos_of(photos)) == ["4.jpg"]
    assert folder.unread_of(tmp_path / "none") == {}
    (photos / "4.jpg").unlink()
    with pytest.raises(SceneError, match=r"no photos\. 1 \.CR2, 1 \.DNG, 2 \.NEF files were not"):
        folder.photos_of(photos)


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such pipes")
def test_a_pipe_in_place_of_the_log_is_not_waited_for(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Folder(tmp_path / "scene").log
    log.parent.mkdir(parents=True)
    (log.parent / "state.json").write_text('{"version": 1, "photos": {}}')
    os.mkfifo(log)
    assert main(["reconstruct", str(photos), "--out", str(tmp_path / "scene")]) == 2
    assert f"Cannot write {log}" in capsys.readouterr().err.splitlines()[-1]


def written(model: Path, text: str) -> Path:
    model.mkdir(parents=True)
    for name in ("cameras.bin", "images.bin"):
        (model / name).write_text(text)
    return model


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")
def test_killed_while_models_are_exchanged_it_still_knows_the_earlier_one(tmp_path: Path) -> None:
    """Else the next engine would place cameras anew, and boxes would lose their place."""
    start, root = tmp_path / "start", tmp_path / "scene"
    first = Folder(start)
    first.work().mkdir(parents=True)
    first.begin([], {})
    written(first.model, "first")
    written(first.work("models", "more"), "second")
    first.finish("first")
    for number in killed_everywhere(start, root, partial(grown, root)):
        folder = Folder(root)
        with folder.held(QUIET.warn):
            assert folder.finished_model is not None, f"killed before change {number}"
            assert (folder.model / "images.bin").read_text() in ("first", "second")
    assert number > 8 and (folder.model / "images.bin").read_text() == "second"
    assert (folder.work("earlier", "0") / "images.bin").read_text() == "first"
    shutil.rmtree(folder.model)  # by the user, who wants another
    with folder.held(QUIET.warn):
        assert folder.finished_model is None


OTHERS = (
    *("reconstruction.md", "database.db", "reconstruction/log.txt", "reconstruction/photos.json"),
    *("reconstruction/state.json", "reconstruction/run.lock", "reconstruction/masks/0.png"),
    *("reconstruction/events.jsonl", "reconstruction/notes.txt", "reconstruction/models/a"),
)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("text", ["mine", '{"version": 3}'])
def test_files_of_others_that_are_called_like_ours(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str
) -> None:
    path = tmp_path / "scene" / name
    path.parent.mkdir(parents=True)
    path.write_text(text)
    database = tmp_path / "scene" / "database.db"
    if name == "reconstruction/state.json":  # by its name alone, it made the database ours
        database.write_text("mine")
    assert main(["reconstruct", str(photos), "--out", str(tmp_path / "scene")]) == 2
    assert "was not " in capsys.readouterr().err.splitlines()[-1]
    assert path.read_text() == text
    assert path == database or not database.exists() or database.read_text() == "mine"


def test_a_start_that_was_killed_goes_on(photos: Path, tmp_path: Path) -> None:
    """Before anything else is written, the record says whose the folder is."""
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    folder.work("run.lock").touch()
    with folder.held(QUIET.warn):
        folder.work("photos.json").write_text("half")
    with folder.held(QUIET.warn):
        assert folder.begin(looked(folder, photos), {}) == ""
