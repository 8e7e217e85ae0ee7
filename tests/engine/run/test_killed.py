"""Killed or stopped anywhere, an engine resumes and ends with the same bytes."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.run.definition import MANIFEST_VERSION
from roigs_engine.run.manifest import claim
from tests.engine.faults import ENDINGS
from tests.engine.killing import SECRET, Ended, Request, contents, engine, killed_everywhere, tree

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")

# The work during which the engine is killed; the seed draws the moment.
PLACES = [
    "undistort: check",
    "undistort: half of",
    "undistort: before",
    "manifest.json",
    "half of split",
    "full-scene: step",
    "full-scene: before checkpoint.bin",
    "undistort: .*thing",
    "^scene: step",
    "^scene: edit",
    "^scene: half of checkpoint",
    "^scene: after checkpoint.before.bin",
    "^scene: half of model",
    "^scene: after model.ply",
    "^scene: after stage.json",
    "object-thing: step",
    "object-thing: edit",
    "object-thing: half of checkpoint",
    "object-thing: (half of|before) (result|background|thing)",
    "evaluate: check",
    "evaluate: (half|before|after)",
]


# Everything else that may happen, each at places of other work.
STOPS = [
    ("interrupted", "undistort: check"),
    ("interrupted", "full-scene: edit"),
    ("interrupted", "^scene: half of checkpoint"),
    ("interrupted", "object-thing: (half of|before) (result|background|thing)"),
    ("interrupted", "evaluate: check"),
    ("impatience", "manifest.json"),
    ("impatience", "undistort: half of"),
    ("impatience", "^scene: step"),
    ("impatience", "^scene: half of checkpoint"),
    ("impatience", "^scene: after checkpoint.before.bin"),
    ("impatience", "evaluate: (half|before|after)"),
    ("terminated", "undistort: before"),
    ("terminated", "undistort: .*thing"),
    ("terminated", "^scene: edit"),
    ("terminated", "object-thing: half of checkpoint"),
    ("hangup", "undistort: check"),
    ("hangup", "full-scene: step"),
    ("hangup", "^scene: after model.ply"),
    ("hangup", "object-thing: edit"),
    ("hangup", "evaluate: check"),
    ("reader", "undistort: check"),
    ("reader", "^scene: step"),
    ("reader", "object-thing: step"),
    ("reader", "evaluate: (half|before|after)"),
    ("input", "full-scene: step"),
    ("input", "object-thing: half of checkpoint"),
]


def ended_well(ended: Ended, fault: str) -> None:
    """The documented status, and no traceback."""
    assert ended.status in ENDINGS[fault], ended.errors
    assert "Traceback" not in ended.errors and "ignored" not in ended.errors, ended.errors


def test_killed_and_stopped_again_and_again(request_: Request, tmp_path: Path) -> None:
    for place, fault in (
        ("undistort: half of", "killed"),
        ("^scene: half of checkpoint", "impatience"),
        ("^object-thing: after checkpoint.before.bin", "killed"),
        ("full-scene: step", "hangup"),
        ("evaluate: check", "reader"),
    ):
        ended_well(engine(request_.arguments(tmp_path), request_.moment(place, fault)), fault)
    request_.finish(tmp_path)
    entries = json.loads((tmp_path / "provenance.json").read_text(encoding="utf-8"))["entries"]
    ended = [entry["ended"] for entry in entries]
    assert ended[1:3] == ["killed", "stopped"] and ended[-1] == "done"
    # A build of torch may have a local version (+cu130) that its metadata lack.
    torch_version = entries[-1]["versions"]["torch"].partition("+")[0]
    assert torch_version == torch.__version__.partition("+")[0]
    assert entries[-1]["threads"] == 2 and entries[-1]["seed"] == 0
    assert entries[-1]["machine"]["chip"] and entries[-1]["kernels"]
    assert set(entries[-1]["stages"]) == {"full-scene", "scene", "object-thing"}


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_killed_once(request_: Request, tmp_path: Path, place: str) -> None:
    ended_well(engine(request_.arguments(tmp_path), request_.moment(place)), "killed")
    request_.finish(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "place"), STOPS)
def test_stopped_once(request_: Request, tmp_path: Path, fault: str, place: str) -> None:
    ended = engine(request_.arguments(tmp_path), request_.moment(place, fault))
    ended_well(ended, fault)
    resumed = request_.finish(tmp_path)
    if ended.status in (0, 3):  # with a checkpoint, so that no step is done twice
        assert ended.steps + resumed.steps == request_.steps


def test_any_number_of_threads_makes_the_same_bytes(request_: Request, tmp_path: Path) -> None:
    assert engine(request_.arguments(tmp_path, threads=1)).status == 0
    assert contents(tmp_path) == contents(request_.whole)


def test_no_secret_of_the_environment_is_written(request_: Request) -> None:
    for path in request_.whole.rglob("*"):
        assert path.is_dir() or SECRET.encode() not in path.read_bytes()


# --- killed while `--update` moves results ---


def manifest(seed: int, **boxes: float) -> dict[str, Any]:
    rois = [{"name": name, "half_extents": [size]} for name, size in boxes.items()]
    return {"version": MANIFEST_VERSION, "config": {"seed": seed}, "rois": rois}


def trained(run: Path, of: dict[str, Any], boxes: Sequence[str]) -> None:
    """Go over to a manifest, and write what only a training and `levels` could make again."""
    claim(run, of, update=True)
    names = ["result.ply", "report.md", "levels/1/background.ply", "levels.json"]
    names += ["compare-independent/result.ply"]
    for box in boxes:
        names += [f"rois/{box}.ply", f"levels/1/rois/{box}.ply"]
    for name in names:
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        (run / name).write_text(json.dumps({"of": of["config"], "file": name}))


FIRST, SECOND = manifest(0, a=1, b=2), manifest(1, a=1, b=2)


@pytest.mark.parametrize(
    "now",
    [
        pytest.param(FIRST, id="settings of before"),
        pytest.param(manifest(1, b=1, c=2), id="other names", marks=pytest.mark.slow),
    ],
)
def test_an_update_killed_before_any_of_its_changes(tmp_path: Path, now: dict[str, Any]) -> None:
    """The same command again ends as if it had never been killed, and so does the way back."""
    start, whole, run = (tmp_path / name for name in ("start", "whole", "run"))
    trained(start, FIRST, "ab")
    trained(start, SECOND, "a")
    shutil.copytree(start, whole)
    claim(whole, now, update=True)
    updated = tree(whole)
    claim(whole, SECOND, update=True)
    for number in killed_everywhere(start, run, partial(claim, run, now, update=True), step=2):
        claim(run, now, update=True)
        assert tree(run) == updated, f"killed before change {number}"
        claim(run, SECOND, update=True)
        assert tree(run) == tree(whole), f"killed before change {number}"
    assert number > 8, "it makes more changes than that"


def test_an_update_killed_and_not_wanted_any_more(tmp_path: Path) -> None:
    """The settings of before, again, find their results where they were."""
    run, start = tmp_path / "run", tmp_path / "start"
    trained(start, FIRST, "ab")
    for number in killed_everywhere(start, run, partial(claim, run, SECOND, update=True), step=2):
        claim(run, FIRST, update=True)
        assert tree(run) == tree(start), f"killed before change {number}"
