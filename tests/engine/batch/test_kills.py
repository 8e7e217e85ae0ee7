"""Batches whose drivers, engines, machines and heads are killed at random: the same bytes."""

from __future__ import annotations

import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from tests.engine.batch.clusters import EACH, a_cluster, engines
from tests.engine.batches import contents, table_of
from tests.engine.commands.command_line import BOX, python, start
from tests.engine.synthetic_colmap import write_project

KILLS, SEED, SCENES = 20, 4, 12
PARTS = """\
[defaults]
scene = "hall"
roi = ["{box}"]
steps-factor = 0.05
test-every = 4
device = "cpu"
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc"),
]


class Done:
    """Notes stages that are done, and checks that they stay as they are."""

    def __init__(self) -> None:
        self._times: dict[Path, int] = {}

    def check(self, run: Path) -> None:
        for path in run.glob(f"*/{run_files.STAGES}/*/{run_files.STAGE}"):
            time_ = path.stat().st_mtime_ns
            assert self._times.setdefault(path, time_) == time_, f"{path} was trained again"


def same_as_by_hand(run: Path, names: list[str], by_hand: Path) -> None:
    for name in names:
        row = run / run_files.BATCH_ROWS / f"{name}.json"
        if not (by_hand / name).exists():
            assert main(["run", str(row), "--run-dir", str(by_hand / name)]) == 0
        assert contents(run / name) == contents(by_hand / name)


def kill_one(processes: list[int], rng: random.Random) -> bool:
    """Whether there was one to kill."""
    for process in rng.sample(processes, min(1, len(processes))):
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(process, signal.SIGKILL)
            return True
    return False


def test_killed_at_random(tmp_path: Path) -> None:
    rng = random.Random(SEED)
    for name in ("hall", "attic"):
        write_project(tmp_path / name, names=[f"{k}.png" for k in range(10)], dots=True)
    table, run = table_of(tmp_path, tmp_path), tmp_path / "run"
    options = ("batch", table, "--run-dir", run, "--jobs", "2")
    kills, done = 0, Done()
    while kills < KILLS:
        with start(*options, "--retries", "100") as batch:
            for _ in range(rng.randint(1, 6)):  # engines, then their driver
                time.sleep(rng.uniform(1, 8))
                kills += kill_one(engines(run), rng)
            batch.kill()
            kills += 1
        done.check(run)
    ended = python(*options)
    assert ended.returncode == 0, ended.stderr
    same_as_by_hand(run, ["hall", "attic"], tmp_path / "hand")
    assert not list(run.rglob("*.lock"))


def test_killed_at_random_on_a_cluster(tmp_path: Path) -> None:
    rng, ends, round_ = random.Random(SEED), Counter[str](), 0
    kinds = [*("driver", "engine", "machine", "head")] * (KILLS // 4)
    rng.shuffle(kinds)
    write_project(tmp_path / "hall", names=[f"{k}.png" for k in range(8)], dots=True)
    names = [f"hall-{seed}" for seed in range(SCENES)]
    table = tmp_path / "museum.toml"
    rows = [f"[scenes.{name}]\nseed = {seed}" for seed, name in enumerate(names)]
    table.write_text("\n".join([PARTS.format(box=BOX), *rows]), encoding="utf-8")
    while kinds:  # each round: until all is done, in a new folder
        run, done, status = tmp_path / f"run-{round_}", Done(), None
        while status != 0:
            with a_cluster() as cluster:
                head_lives = True
                while head_lives and status != 0:
                    status, head_lives = one_batch(cluster, table, run, rng, kinds)
                    ends[f"status {status}"] += 1
                    done.check(run)
        same_as_by_hand(run, names, tmp_path / "hand")
        assert not list(run.rglob("*.lock"))
        round_ += 1
    print(f"{KILLS} kills in {round_} rounds; batches ended with {dict(ends)}")


def one_batch(
    cluster: Any, table: Path, run: Path, rng: random.Random, kinds: list[str]
) -> tuple[int, bool]:
    """A batch with the next kills until it ends; its exit status, and whether the head lives."""

    def kill_machine() -> bool:
        cluster.remove_node(cluster.second, allow_graceful=False)
        cluster.second = cluster.add_node(**EACH)
        return True

    def kill_driver() -> bool:
        batch.kill()
        return True

    def kill_head() -> bool:
        cluster.head_node.kill_all_processes(check_alive=False, allow_graceful=False)
        return True

    kill: dict[str, Callable[[], bool]] = {
        "engine": lambda: kill_one(engines(run), rng),
        "machine": kill_machine,
        "driver": kill_driver,
        "head": kill_head,
    }
    options = ("--run-dir", run, "--cluster", cluster.address, "--retries", "100")
    killed = ""
    with start("batch", table, *options) as batch:
        while batch.poll() is None and killed not in ("driver", "head"):
            killed = ""
            time.sleep(rng.uniform(4, 12))
            if batch.poll() is None and kinds and kill[kinds[-1]]():
                killed = kinds.pop()
        out, errors = batch.communicate(timeout=600)
    assert "Traceback" not in errors, errors
    if killed == "head":
        assert batch.returncode == 2, errors
        last = errors.splitlines()[-1]  # "there is no" if it had not joined yet
        assert last.startswith(("error: The Ray cluster", "error: There is no Ray cluster")), errors
    elif killed != "driver":
        assert batch.returncode == 0, errors + out
    return batch.returncode, killed != "head"
