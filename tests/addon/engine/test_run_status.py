"""The state of a run folder."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from roigs_addon.engine import run_status
from roigs_addon.engine.own_files import stage_in_words, warning_in_words
from roigs_addon.engine.run_status import RunStatus
from roigs_engine.formats.run_files import MANIFEST
from tests.addon.engine.folders import HOLD, write
from tests.addon.scenes import ROOT, listed_stage


def test_a_run_is_read_from_its_folder(tmp_path: Path) -> None:
    assert run_status.read(tmp_path / "none") == RunStatus()
    write(listed_stage(tmp_path, "scene") / "stage.json")
    write(listed_stage(tmp_path, "object-vase") / "checkpoint.bin")
    write(tmp_path / "stages" / "joint-1234abcd" / "checkpoint.bin")  # of other settings
    box = {"name": "vase", "world_to_box": [[1]], "half_extents": [1]}
    write(tmp_path / MANIFEST, json.dumps({"rois": [box]}))
    run = run_status.read(tmp_path)
    assert run.done == ("scene",) and run.left == "object-vase" and not run.result
    assert run.boxes == {"vase": ([[1]], [1])}
    assert stage_in_words(run.left) == "box 'vase'"
    assert stage_in_words("cutout") == "objects alone"
    write(tmp_path / MANIFEST, "no JSON")
    assert run_status.read(tmp_path).boxes is None


def test_a_running_engine_is_told_from_a_leftover_lock(tmp_path: Path) -> None:
    write(tmp_path / "run.lock", '{"pid": 1, "started": 1.0, "events_from": 0}')
    assert run_status.read(tmp_path).holder == 0
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    ) as engine:
        assert engine.stdout is not None and engine.stdin is not None
        assert engine.stdout.readline() == "held\n"
        assert run_status.read(tmp_path).holder == engine.pid
        engine.stdin.close()
    assert run_status.read(tmp_path).holder == 0


def test_warnings_name_stages_in_words() -> None:
    assert warning_in_words("joint: 1 photo: 'a: b'") == "all boxes: 1 photo: 'a: b'"
    assert warning_in_words("Few photos see 'vase'.") == "Few photos see 'vase'."
