"""Damaged input ends well or in one line: thousands of cases, see `cases.py`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import warm_engine
from tests.fuzz import cases, runner

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bounds memory as Linux does")
HEALTHY = ("scales", "working_folders")  # far off, or beside what is hostile
WHOLE = ("inspect", "export", "select")  # commands that are quick to start


def assert_sound(result: runner.Result) -> None:
    assert not result.wrong, "\n\n".join(f"{k}\n{v}" for k, v in list(result.wrong.items())[:5])
    assert result.peak_mib < 2048


def test_a_sample() -> None:
    result = runner.Result()
    chosen = [f"{family} {number}" for number, family in enumerate(cases.all_families())]
    runner.work(chosen, result, warm_engine.module("tests.fuzz.worker"))
    assert result.cases == len(chosen)
    assert_sound(result)


@pytest.mark.slow
def test_thousands() -> None:
    result = runner.run(1.0)
    assert result.cases >= 7000
    assert_sound(result)
    for family in cases.all_families():  # neither is all refused, nor all taken
        some_refused = result.ended[family, "2"] or family in HEALTHY
        some_taken = result.ended[family, "0"] or family == "convert_much"  # bombs, all of them
        assert some_taken and some_refused, family


def ended(tmp_path: Path, family: str, number: int) -> int:
    """The exit status of a case on a command line of its own; -1: another kind of command."""
    command = cases.make(family, number, tmp_path)
    if command[0] not in WHOLE:
        return -1
    done = subprocess.run(
        warm_engine.command(command),
        cwd=runner.ROOT,
        env=os.environ | {"PYTHONPATH": str(runner.ROOT)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=120,
        check=False,
    )
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode in (0, 2) and len(errors) == (done.returncode == 2), done.stderr
    assert "Traceback" not in done.stderr and "Warning:" not in done.stderr
    return done.returncode


def test_the_command_line_says_it_too(tmp_path: Path) -> None:
    seen = [ended(tmp_path / str(number), "model_bytes", number) for number in range(6)]
    assert 2 in seen


@pytest.mark.slow
@pytest.mark.parametrize("family", ["model_values", "model_text", "photos", "rois", "requests"])
def test_the_command_line_at_length(tmp_path: Path, family: str) -> None:
    seen = [ended(tmp_path / str(number), family, number) for number in range(30)]
    assert 2 in seen
