"""A reconstruction that is killed, and disks that are full or may not be written to."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.colmap.project import load_colmap
from roigs_engine.reconstruction.database import feature_counts
from tests.engine.commands.command_line import python, start
from tests.engine.reconstruction.photo_sets import copy_photos, demo_photos

pytest.importorskip("pycolmap")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills and mounts")


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    chosen = demo_photos("wide/*.jpg", 6)
    copy_photos(tmp_path / "photos", chosen, [f"a {number}.jpg" for number in range(6)])
    return tmp_path / "photos"


@pytest.mark.slow
def test_killed_in_each_phase_it_resumes(photos: Path, tmp_path: Path) -> None:
    out, known = tmp_path / "scene", 0
    words = ("reconstruct", photos, "--out", out, "--features", 2000, "--events", "--threads", 1)
    for stage in ("look at photos", "features", "matching", "mapping"):
        with start(*words, cold=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                record = json.loads(line)
                if record.get("stage") == stage and record["event"] == "progress":
                    break
            else:
                pytest.fail(f"{stage} did not begin")
            process.kill()
        if (out / "database.db").exists():
            there = len(feature_counts(out / "database.db"))
            assert there >= known
            known = there
    assert known == 6
    ended = python(*words)
    assert ended.returncode == 0, ended.stderr
    assert len(load_colmap(out, pixels=False).images) == 6
    stages = [
        record["stage"]
        for record in map(json.loads, ended.stdout.splitlines())
        if record["event"] == "stagestarted"
    ]
    assert "features" not in stages and "matching" not in stages


def refused(capsys: pytest.CaptureFixture[str], photos: Path, out: Path) -> str:
    words = ["reconstruct", photos, "--out", out, "--features", 2000, "--threads", 1]
    assert main([str(word) for word in words]) == 2
    err = capsys.readouterr().err
    assert "Traceback" not in err
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    return line


def test_a_folder_that_may_not_be_written(
    photos: Path,
    mounted: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    disk = mounted("size=1m")
    mounted("ro")
    assert "Cannot write" in refused(capsys, photos, disk / "scene")
    assert not list(disk.iterdir())


@pytest.mark.slow
def test_a_disk_that_is_full_for_a_while(
    photos: Path,
    mounted: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """During the copies of the photos, in the features and in the matches."""
    disk, size = mounted("size=300k"), photo_bytes(photos)
    for room in ("300k", f"{(size >> 10) + 400}k", f"{(size >> 10) + 1800}k"):
        mounted(f"size={room}")
        line = refused(capsys, photos, disk / "scene")
        assert "full" in line or "No space left" in line or "Free some space" in line, line
    mounted("size=200m")
    words = ["reconstruct", photos, "--out", disk / "scene", "--features", 2000]
    assert main([str(word) for word in words]) == 0
    assert len(load_colmap(disk / "scene", pixels=False).images) == 6


def photo_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())
