"""A batch whose drivers and engines are killed at random, again and again: the same bytes."""

from __future__ import annotations

import os
import random
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from tests.engine.batch.test_ray import engines
from tests.engine.commands.command_line import python, start
from tests.engine.commands.test_batch import contents, table_of
from tests.engine.synthetic_colmap import write_project

KILLS, SEED = 20, 4


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc")
def test_killed_at_random(tmp_path: Path) -> None:
    rng = random.Random(SEED)
    for name in ("hall", "attic"):
        write_project(tmp_path / name, names=[f"{k}.png" for k in range(10)], dots=True)
    table, run = table_of(tmp_path, tmp_path), tmp_path / "run"
    options = ("batch", table, "--run-dir", run, "--jobs", "2")
    kills, done = 0, {}
    while kills < KILLS:
        with start(*options, "--retries", "100") as batch:
            for _ in range(rng.randint(1, 6)):  # engines, then their driver
                time.sleep(rng.uniform(1, 8))
                for process in rng.sample(found := engines(run), min(1, len(found))):
                    with suppress(ProcessLookupError):  # it has just ended
                        os.kill(process, signal.SIGKILL)
                        kills += 1
            batch.kill()
            kills += 1
        for path in run.glob(f"*/*/{run_files.STAGE}"):  # what was done stays as it is
            assert done.setdefault(path, path.stat().st_mtime_ns) == path.stat().st_mtime_ns
    ended = python(*options)
    assert ended.returncode == 0, ended.stderr
    for name in ("hall", "attic"):
        row = run / run_files.BATCH_ROWS / f"{name}.json"
        assert main(["run", str(row), "--run-dir", str(tmp_path / "hand" / name)]) == 0
        assert contents(run / name) == contents(tmp_path / "hand" / name)
    assert not list(run.rglob("*.lock"))
