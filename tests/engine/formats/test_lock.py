"""The lock of a run folder: one holder, gone with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.formats.lock import holder, locked

ROOT = Path(__file__).resolve().parents[3]
HOLD = """
import sys
from pathlib import Path
from roigs_engine.formats.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_file_says_who_and_goes_with_the_block(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    with locked(folder):
        (folder / "events.jsonl").write_text("{}\n", encoding="utf-8")
        record = json.loads((folder / "run.lock").read_text(encoding="utf-8"))
        assert record["pid"] == os.getpid() and record["started"] > 1.7e9
        assert record["events_from"] == 0
    assert [path.name for path in folder.iterdir()] == ["events.jsonl"]
    with locked(folder):
        record = json.loads((folder / "run.lock").read_text(encoding="utf-8"))
        assert record["events_from"] == 3


def test_a_folder_that_stays_empty_goes_too(tmp_path: Path) -> None:
    with locked(tmp_path / "run"):
        pass
    assert not (tmp_path / "run").exists()


def test_another_process_is_kept_out_until_it_dies(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(RunFolderError, match=f"process {holder.pid}"), locked(tmp_path):
            pass
        holder.kill()
    assert (tmp_path / "run.lock").exists()
    with locked(tmp_path):
        assert json.loads((tmp_path / "run.lock").read_text(encoding="utf-8"))["pid"] == os.getpid()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"run\.lock"), locked(tmp_path / "file"):
        pass


def test_others_see_who_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    assert holder(path) == 0
    with locked(tmp_path):
        assert holder(path) == os.getpid()
    tmp_path.mkdir(exist_ok=True)
    path.write_text("nobody", encoding="utf-8")  # as a killed engine leaves it
    assert holder(path) == 0
