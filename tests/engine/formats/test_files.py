"""Atomic writes: a file has its name only when it is complete."""

from __future__ import annotations

import errno
import os
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_addon.engine.exported_model import read_numbers
from roigs_engine.cli import main
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.files import (
    ABANDONED,
    LARGEST,
    atomic_write,
    cannot_write,
    own_file,
    own_folder,
    read_bytes,
    read_json,
    remove_leftovers,
    sha256,
    write_json,
    write_text,
)
from roigs_engine.photos.contents import read_contents
from tests.addon.colmap_project import write_project
from tests.engine.other_process import in_the_middle

ROOT = Path(__file__).resolve().parents[3]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_text_and_json_there_and_back(tmp_path: Path) -> None:
    value = {"nazwa": "żółw", "list": [1, 2.5, None]}
    write_json(tmp_path / "new folder" / "a.json", value)
    assert read_json(tmp_path / "new folder" / "a.json") == value
    assert "żółw" in (tmp_path / "new folder" / "a.json").read_text(encoding="utf-8")
    write_text(tmp_path / "t.txt", "a\nb")
    assert (tmp_path / "t.txt").read_bytes() == b"a\nb"
    assert names(tmp_path) == ["new folder", "t.txt"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failing_block_leaves_the_old_file(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with atomic_write(path) as file:
            file.write(b"half of the new")
            raise error

    with pytest.raises(error):
        fail()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_new_content_appears_at_the_end_only(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with atomic_write(path) as file:
        file.write(b"all")
        file.flush()
        assert not path.exists()
    assert path.read_bytes() == b"all"
    assert names(tmp_path) == ["a.bin"]


def test_the_one_before_is_on_the_disk_before_the_new_one_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So a power cut costs a checkpoint at most, though the new one is not waited for."""
    path, before, order = tmp_path / "checkpoint", tmp_path / "before", list[str]()
    path.write_bytes(b"one")
    inode, sync, rename = path.stat().st_ino, os.fsync, os.replace

    def synced(number: int) -> None:
        order.append("synced" if os.fstat(number).st_ino == inode else "other")
        sync(number)

    def renamed(source: Path, target: Path) -> None:
        order.append(target.name)
        rename(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    with atomic_write(path, durable=False, before=before) as file:
        file.write(b"two")
    assert order == ["synced", "before", "checkpoint"]
    assert (before.read_bytes(), path.read_bytes()) == (b"one", b"two")


def test_unwritable_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(RunFolderError) as caught:
        write_text(tmp_path / "file" / "a.txt", "x")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("way", ["file", "dangling"])
def test_what_is_in_the_way_is_named(tmp_path: Path, way: str) -> None:
    if way == "file":
        (tmp_path / "out").write_text("in the way", encoding="utf-8")
    else:
        (tmp_path / "out").symlink_to(tmp_path / "nothing")
    with pytest.raises(RunFolderError, match=r"Cannot write .*out \(.*Move away the file"):
        write_text(tmp_path / "out" / "points.npy", "x")


@pytest.mark.parametrize("code", ["EEXIST", "ENOTEMPTY", "EISDIR", "ENOTDIR", "ENOSPC"])
def test_what_to_do_follows_from_what_is_wrong(tmp_path: Path, code: str) -> None:
    number = getattr(errno, code)
    error = cannot_write(tmp_path / "a", OSError(number, os.strerror(number)))
    assert error.hint.startswith("Free some space" if code == "ENOSPC" else "Move away")


@pytest.mark.parametrize("content", [None, b"{", b"\xff\xfe", b"[" * 200_000, b"9" * 9000])
def test_unreadable_json_is_one_line(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(RunFolderError) as caught:
        read_json(tmp_path / "a.json")
    assert "\n" not in str(caught.value)


def test_names_on_disk_that_are_no_utf8(tmp_path: Path) -> None:
    """They come with lone surrogates, which JSON can hold and UTF-8 cannot."""
    write_json(tmp_path / "a.json", {"name": "caf\udce9"})
    assert read_json(tmp_path / "a.json") == {"name": "caf\udce9"}


# --- temporary files of other processes ---

HALF = """
import sys, time
from pathlib import Path
from roigs_engine.formats.files import atomic_write
with atomic_write(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    print("half", flush=True)
    sys.stdin.read()
    file.write(b" and half")
"""


def test_what_another_process_is_writing_stays(tmp_path: Path) -> None:
    path = tmp_path / "nest" / "renders" / "a.png"
    with in_the_middle(HALF, path, "half"):
        remove_leftovers(tmp_path)
        assert len(names(path.parent)) == 1
    assert path.read_bytes() == b"half and half"
    assert names(path.parent) == ["a.png"]


def test_what_a_killed_process_has_left_goes(tmp_path: Path) -> None:
    path = tmp_path / "nest" / "a.png"
    with in_the_middle(HALF, path, "half") as process:
        process.kill()
    assert len(names(path.parent)) == 1
    (tmp_path / ".notes.12.part").touch()  # not one of ours
    remove_leftovers(tmp_path)
    assert names(path.parent) == [] and names(tmp_path) == [".notes.12.part", "nest"]


@pytest.mark.skipif(os.name != "posix", reason="Windows has its locks everywhere")
def test_leftovers_without_locks_go_by_their_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    with in_the_middle(HALF, tmp_path / "a.png", "half") as process:
        process.kill()
    monkeypatch.setattr(fcntl, "flock", refuse)
    write_text(tmp_path / "b.txt", "writing needs no locks")
    remove_leftovers(tmp_path)
    assert len(names(tmp_path)) == 2
    left = next(tmp_path.glob(".*"))
    os.utime(left, (time.time() - 2 * ABANDONED,) * 2)
    remove_leftovers(tmp_path)
    assert names(tmp_path) == ["b.txt"]


def test_threads_that_write_the_same_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"

    def write(number: int) -> None:
        with atomic_write(path, durable=False) as file:
            file.write(bytes([number]) * 1000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(64)))
    assert len(set(path.read_bytes())) == 1 and names(tmp_path) == ["a.bin"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(RunFolderError, match="Not a file"):
        write_text(tmp_path / "pipe.ply", "text")
    assert stat.S_ISFIFO((tmp_path / "pipe.ply").stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.ply"]


def test_text_of_gigabytes_is_not_read(tmp_path: Path) -> None:
    """A file of nothing but a hole takes no disk, and all of the memory."""
    path = tmp_path / "a.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(RunFolderError, match=r"a\.json \((File too large|Nothing but holes)\)"):
        read_json(path)
    with path.open("wb") as file:
        file.truncate(LARGEST + 1)
    with pytest.raises(OSError, match="File too large"):
        read_bytes(path)
    assert len(read_bytes(path, most=None)) == LARGEST + 1  # the pictures and buffers of a model


OUTSIDE = (
    "/x",
    "../x",
    "a/../../x",
    "..\\x",
    "C:x",
    "C:\\x",
    "\\\\host\\a\\x",
    "a\0",
    "",
    ".",
)


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_name_that_a_file_says_stays_in_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(RunFolderError, match=f"is not a valid file name in {tmp_path}"):
        own_file(tmp_path, name)
    if ".." in name or name.startswith("/"):
        with pytest.raises(RunFolderError, match="is not a valid file name"):
            own_folder(tmp_path, "a", name)


def test_a_name_may_have_folders(tmp_path: Path) -> None:
    assert own_file(tmp_path, "a/b..c.ply") == tmp_path / "a" / "b..c.ply"
    assert own_folder(tmp_path, "", "a/b") == tmp_path / "a" / "b"
    assert own_folder(tmp_path) == tmp_path
    (tmp_path / "a").symlink_to(tmp_path)
    with pytest.raises(RunFolderError, match="is a link"):
        own_file(tmp_path, "a/x")


# --- files of holes: a download of a few bytes that would fill the memory ---

POSIX = pytest.mark.skipif(os.name != "posix", reason="files have holes there")


def made_of_holes(path: Path, head: bytes = b"") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head)
    os.truncate(path, 6 << 30)
    return path


@POSIX
@pytest.mark.parametrize("head", [b"", b"x" * 5000])
def test_a_file_of_holes_is_not_read(tmp_path: Path, head: bytes) -> None:
    path = made_of_holes(tmp_path / "a", head)
    for read in (lambda: read_bytes(path, most=None), lambda: sha256(path)):
        with pytest.raises(OSError, match="Nothing but holes"):
            read()
    os.truncate(path, 60 << 20)  # so much is read, whatever is in it
    assert len(read_bytes(path, most=None)) == 60 << 20


@POSIX
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_a_model_with_a_hole_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    model = write_project(tmp_path / "scene") / "sparse" / "0"
    (path,) = model.glob(f"{name}.*")
    made_of_holes(path, path.read_bytes())
    assert main(["inspect", str(tmp_path / "scene")]) == 2
    assert "Nothing but holes" in capsys.readouterr().err


@POSIX
def test_a_photo_with_a_hole_is_unreadable(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    Image.new("RGB", (64, 64)).save(path, progressive=True)
    found = read_contents({"a.jpg": made_of_holes(path, path.read_bytes())})
    assert found["a.jpg"].whole is False


@POSIX
def test_numbers_of_a_stranger_with_a_hole(tmp_path: Path) -> None:
    path = tmp_path / "points.npy"
    np.save(path, np.zeros((2, 3), np.float32))
    made_of_holes(path, path.read_bytes().replace(b"(2, 3)", b"(200000000, 3)"))
    with pytest.raises(OSError, match="Nothing but holes"):
        read_numbers(tmp_path, "points.npy", 3)


def test_the_first_file_of_a_process_tidies_its_folder(tmp_path: Path) -> None:
    """Any command does, after any other one was killed while it wrote."""
    dead = tmp_path / ".points.npy.4000000-0123abcd.part"
    others = (tmp_path / ".points.npy.part", tmp_path / "a.part", tmp_path / "below" / dead.name)
    for path in (dead, *others):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"half")
    write_text(tmp_path / "scene.json", "x")
    assert not dead.exists() and all(path.exists() for path in others)
