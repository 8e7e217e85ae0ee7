"""The state of a reconstruction's folder, by the files that the engine writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_addon.engine import reconstruction
from roigs_addon.engine.own_files import stage_in_words, step_in_words
from roigs_addon.engine.reconstruction import ReconstructionStatus
from tests.addon.engine.folders import HOLD, write
from tests.addon.scenes import ROOT


def begin(folder: Path, *, done: str | None) -> None:
    write(folder / "reconstruction" / "state.json", json.dumps({"version": 1, "done": done}))


def finish(folder: Path) -> None:
    begin(folder, done="key")
    for name in ("cameras", "images", "points3D"):
        write(folder / "sparse" / "0" / f"{name}.bin")


def test_a_folder_is_read(tmp_path: Path) -> None:
    nothing = ReconstructionStatus()
    assert reconstruction.read(tmp_path / "none") == nothing
    write(tmp_path / "reconstruction" / "state.json", "[")
    assert reconstruction.read(tmp_path) == nothing
    begin(tmp_path, done=None)
    assert reconstruction.read(tmp_path) == ReconstructionStatus(unfinished=True)
    finish(tmp_path)
    assert reconstruction.read(tmp_path) == ReconstructionStatus(done=True)
    (tmp_path / "sparse" / "0" / "images.bin").unlink()
    assert reconstruction.read(tmp_path).unfinished


def test_a_killed_one_with_an_earlier_result_is_unfinished(tmp_path: Path) -> None:
    finish(tmp_path)
    write(tmp_path / "reconstruction" / "run.lock")
    found = reconstruction.read(tmp_path)
    assert found.done and found.unfinished


def test_an_engine_at_work_is_seen(tmp_path: Path) -> None:
    begin(tmp_path, done=None)
    command = [sys.executable, "-c", HOLD, str(tmp_path / "reconstruction")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        found = reconstruction.read(tmp_path)
        process.communicate()
    assert found.holder == process.pid and not found.unfinished


def test_the_report_is_the_engines(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    from roigs_engine.reconstruction.mapping import Mapped
    from roigs_engine.reconstruction.photo_checks import Found, Photo
    from roigs_engine.reconstruction.report import Reconstruction, as_markdown

    names = [f"{number}.jpg" for number in range(4)]
    photos = tuple(
        Photo(name=n, path=Path(n), digest=n, size=(640, 480), device="", sharpness=1.0)
        for n in names
    )
    found = Found(photos=photos, unreadable=("my_notes.jpg",), copies={})
    best = Mapped(
        folder="0", photos=dict.fromkeys(names[:3], 200), points=500, error=0.5, track=3.0
    )
    result = Reconstruction(
        found=found, features=dict.fromkeys(names, 900), matched={}, models=[best], seconds={}
    )
    (tmp_path / reconstruction.REPORT).write_text(as_markdown(result), encoding="utf-8")
    said = reconstruction.read(tmp_path)
    assert said.summary.startswith("3 of 4 photos registered, 500 points")
    assert said.remarks == (
        "1 photo cannot be read and is left out: my_notes.jpg.",
        "1 photo not registered. 3.jpg: no photo matches it.",
    )


def test_only_its_own_or_an_empty_folder_is_free(tmp_path: Path) -> None:
    assert reconstruction.is_free(tmp_path) and reconstruction.is_free(tmp_path / "none")
    write(tmp_path / "database.db")
    assert not reconstruction.is_free(tmp_path)
    assert not reconstruction.is_free(tmp_path / "database.db")
    begin(tmp_path, done=None)
    assert reconstruction.is_free(tmp_path)


def test_names_are_the_engines() -> None:
    pytest.importorskip("PIL")
    from roigs_addon.engine import own_files
    from roigs_engine.reconstruction import folder, mapping, pairs, photo_checks
    from roigs_engine.reconstruction import reconstruct as engine

    assert (reconstruction.WORK, reconstruction.REPORT) == (folder.WORK, folder.REPORT)
    stages = (own_files.LOOK, own_files.FEATURES, own_files.COMPARE)
    assert stages == (photo_checks.STAGE, engine.FEATURES, pairs.STAGE)
    assert (own_files.MATCHING, own_files.MAPPING) == (engine.MATCHING, mapping.MAPPING)


def test_progress_says_what_it_counts() -> None:
    assert stage_in_words("features") == "finding features"
    assert step_in_words("features", 3, 80) == "Photo 3 of 80"
    assert step_in_words("matching", 1200, 3160) == "Pair 1,200 of 3,160"
    assert step_in_words("mapping", 12, 80) == "12 of 80 photos registered"
    assert step_in_words("scene", 5, 2000) == "Step 5 of 2,000"
