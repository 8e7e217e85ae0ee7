"""Killed anywhere, an engine goes on with the same command and ends with the same bytes."""

from __future__ import annotations

import json
import os
import random
import re
from pathlib import Path
from typing import Any

import pytest

from tests.engine.killing import Moment, engine
from tests.engine.synthetic_colmap import camera, write_project

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX's")

SEED = 6
KILLED = -9
# What goes on when the engine is killed; at which of such moments is drawn from the seed.
PLACES = [
    "undistort: check",
    "undistort: half of",
    "undistort: before",
    "request.json",
    "half of split",
    "full-scene: step",
    "full-scene: before checkpoint.bin",
    "(half of thing|thing.json)",
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
    "object-thing: (half of|before) (result|surroundings|thing)",
    "evaluate: check",
    "evaluate: (half|before|after)",
]


class Request:
    """A scene with lens distortion, and what a run that nobody killed has made of it."""

    def __init__(self, folder: Path) -> None:
        lens = camera("OPENCV", params=[100.0, 90.0, 45.0, 40.0, 0.05, 0.01, 0.001, 0.002])
        names = [f"{k}.png" for k in range(10)]
        write_project(folder / "scene", names=names, cameras=[lens], dots=True)
        self._scene, self.whole = folder / "scene", folder / "whole"
        assert engine(self.arguments(self.whole), moments=folder / "moments") == 0
        self.moments: list[str] = json.loads((folder / "moments").read_text(encoding="utf-8"))

    def arguments(self, run: Path, threads: int = 2) -> list[object]:
        """Of the command line."""
        box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
        request = ["run", self._scene, "--roi", box, "--preset", "tiny"]
        return [*request, "--run-dir", run, "--threads", threads]

    def finish(self, run: Path) -> None:
        """Go on with a run to its end, and compare it with the whole one."""
        assert engine(self.arguments(run)) == 0
        assert contents(run) == contents(self.whole)
        for line in (run / "events.jsonl").read_text(encoding="utf-8").splitlines():
            assert json.loads(line)


@pytest.fixture(scope="module")
def request_(tmp_path_factory: pytest.TempPathFactory) -> Request:
    return Request(tmp_path_factory.mktemp("killed"))


def contents(run: Path) -> dict[str, Any]:
    """File -> bytes, without what tells of times: the log, and seconds in the reports."""
    files = {str(p.relative_to(run)): p.read_bytes() for p in run.rglob("*") if p.is_file()}
    for name in ("events.jsonl", "report.md"):
        del files[name]
    return {
        name: timeless(json.loads(data)) if name.endswith(".json") else data
        for name, data in files.items()
    }


def timeless(value: Any) -> Any:
    """JSON without what was measured by the clock."""
    if isinstance(value, dict):
        return {k: timeless(v) for k, v in value.items() if k not in ("seconds", "stages")}
    return [timeless(item) for item in value] if isinstance(value, list) else value


def moment(request: Request, place: str) -> Moment:
    """One of the moments at that place."""
    number = sum(bool(re.search(place, name)) for name in request.moments)
    assert number, f"nothing happens at «{place}»"
    return Moment(place, random.Random(f"{SEED} {place}").randint(1, number))


def test_killed_again_and_again(request_: Request, tmp_path: Path) -> None:
    for place in (
        "undistort: half of",
        "^scene: edit",
        "^object-thing: after checkpoint.before.bin",
        "evaluate: half of",
    ):
        assert engine(request_.arguments(tmp_path), moment(request_, place)) == KILLED
    request_.finish(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_killed_once(request_: Request, tmp_path: Path, place: str) -> None:
    assert engine(request_.arguments(tmp_path), moment(request_, place)) == KILLED
    request_.finish(tmp_path)


def test_any_number_of_threads_makes_the_same_bytes(request_: Request, tmp_path: Path) -> None:
    assert engine(request_.arguments(tmp_path, threads=1)) == 0
    assert contents(tmp_path) == contents(request_.whole)
