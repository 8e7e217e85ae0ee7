"""Killed anywhere, an engine resumes with the same command and ends with the same bytes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch

from tests.engine.killing import SECRET, Request, contents, engine

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")

KILLED = -9
# The work during which the engine is killed; the seed draws the moment.
PLACES = [
    "undistort: check",
    "undistort: half of",
    "undistort: before",
    "manifest.json",
    "half of split",
    "full-scene: step",
    "full-scene: before checkpoint.bin",
    "^full-scene: .*thing",
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


@pytest.fixture(scope="module")
def request_(tmp_path_factory: pytest.TempPathFactory) -> Request:
    return Request(tmp_path_factory.mktemp("killed"))


def test_killed_again_and_again(request_: Request, tmp_path: Path) -> None:
    for place in (
        "undistort: half of",
        "^scene: edit",
        "^object-thing: after checkpoint.before.bin",
        "evaluate: half of",
    ):
        assert engine(request_.arguments(tmp_path), request_.moment(place)).status == KILLED
    request_.finish(tmp_path)
    entries = json.loads((tmp_path / "provenance.json").read_text(encoding="utf-8"))["entries"]
    assert [s["ended"] for s in entries][-2:] == ["killed", "done"]
    assert entries[-1]["versions"]["torch"] == torch.__version__
    assert entries[-1]["threads"] == 2 and entries[-1]["seed"] == 0
    assert entries[-1]["machine"]["chip"] and entries[-1]["kernels"]
    assert set(entries[-1]["stages"]) == {"full-scene", "scene", "object-thing"}


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_killed_once(request_: Request, tmp_path: Path, place: str) -> None:
    assert engine(request_.arguments(tmp_path), request_.moment(place)).status == KILLED
    request_.finish(tmp_path)


def test_any_number_of_threads_makes_the_same_bytes(request_: Request, tmp_path: Path) -> None:
    assert engine(request_.arguments(tmp_path, threads=1)).status == 0
    assert contents(tmp_path) == contents(request_.whole)


def test_no_secret_of_the_environment_is_written(request_: Request) -> None:
    for path in request_.whole.rglob("*"):
        assert path.is_dir() or SECRET.encode() not in path.read_bytes()
