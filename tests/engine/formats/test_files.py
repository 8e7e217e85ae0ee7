"""A name never stands for half a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.formats.files import atomic_write, read_json, write_json, write_text


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


def test_unwritable_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(RunFolderError) as caught:
        write_text(tmp_path / "file" / "a.txt", "x")
    assert "\n" not in str(caught.value)


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
