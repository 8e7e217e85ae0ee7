"""Killed or stopped anywhere, an engine resumes and ends with the same bytes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch

from tests.engine.faults import ENDINGS
from tests.engine.killing import SECRET, Ended, Request, contents, engine

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


@pytest.fixture(scope="module")
def request_(tmp_path_factory: pytest.TempPathFactory) -> Request:
    return Request(tmp_path_factory.mktemp("killed"))


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
    assert entries[-1]["versions"]["torch"] == torch.__version__
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
