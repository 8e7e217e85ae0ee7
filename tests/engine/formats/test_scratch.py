"""Temporary folders of killed processes go, those in use and those of others stay."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from roigs_engine.colmap.undistort import temporary_folder
from roigs_engine.formats.scratch import OWNER, scratch
from tests.engine.other_process import in_the_middle

KILLED = """\
import sys
from pathlib import Path
from roigs_engine.formats.scratch import scratch
with scratch("roigs-a-", Path(sys.argv[1])) as folder:
    (folder / "half").write_bytes(b"half")
    print("half", flush=True)
    sys.stdin.read()
"""


def test_it_is_gone_in_the_end(tmp_path: Path) -> None:
    with suppress(KeyError), scratch("roigs-a-", tmp_path) as folder:
        (folder / "x").write_bytes(b"x")
        raise KeyError
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")
def test_the_next_one_removes_those_of_killed_processes(tmp_path: Path) -> None:
    with in_the_middle(KILLED, tmp_path, "half") as process:
        process.kill()
    (left,) = tmp_path.iterdir()
    assert {path.name for path in left.iterdir()} == {"half", OWNER}
    with in_the_middle(KILLED, tmp_path, "half"):  # still at work
        assert not left.exists()
        with scratch("roigs-a-", tmp_path):
            assert len(list(tmp_path.iterdir())) == 2
        (used,) = tmp_path.iterdir()
        assert (used / "half").exists()


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
def test_what_others_have_stays(tmp_path: Path) -> None:
    """Without the mark, under a longer name, or behind a link, nothing is removed."""
    place, theirs = tmp_path / "place", tmp_path / "theirs"
    theirs.mkdir()
    (theirs / OWNER).touch()
    for name in ("roigs-a-01234567", "roigs-a-0123456789", "roigs-a-mine"):
        (place / name).mkdir(parents=True)
    (place / "roigs-a-01234567" / "mine").touch()
    (place / "roigs-a-0123456789" / OWNER).touch()
    (place / "roigs-a-linked00").symlink_to(theirs)
    (place / "roigs-a-owner000").mkdir()
    (place / "roigs-a-owner000" / OWNER).symlink_to(theirs / OWNER)
    os.mkfifo(place / "roigs-a-pipe0000")
    before = sorted(path.name for path in place.iterdir())
    with scratch("roigs-a-", place):
        pass
    assert sorted(path.name for path in place.iterdir()) == before
    assert (theirs / OWNER).exists()


def test_folders_of_undistorted_photos_are_of_this_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert (temporary_folder() / OWNER).is_file()
