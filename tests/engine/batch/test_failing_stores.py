"""Batches on stores that fail at random calls, whose engines are killed at random: the same bytes.

On folders by `file:` addresses, and on S3 itself: moto's server, with s3fs.
"""

from __future__ import annotations

import os
import random
import signal
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from roigs_engine.batch.staged import stored_run
from roigs_engine.cli import main
from roigs_engine.storage.lease import Lease
from roigs_engine.storage.urls import file_system
from tests.engine.batches import contents
from tests.engine.commands import forked_engines as forked
from tests.engine.synthetic_colmap import write_project
from tests.fuzz.failing_store import ERRORS, MOMENTS, Fault, failing
from tests.warm_engine import CAN_FORK

BATCHES, SEED = 50, 5
FAILS, KILLED = 0.005, 0.25  # shares of all calls and of all engines
MOST_TRIES = 20
LEASES = {"expiry": 4.0, "beat": 1.0}  # seconds
TABLE = """\
[scenes.hall]
scene = "scan"
roi = ["vase=-0.5,-0.5,-0.5,0.5,0.5,0.5", "lamp=-0.9,-0.9,-0.9,0.1,0.1,0.1"]
strategy = "independent"
steps_factor = 0.001
max_side = 32
test_every = 4
device = "cpu"
outputs = ["splat", "compressed.ply"]
"""
"""A scene of six parts: two stages that wait for one, the end, and two outputs."""
__all__ = ["forked_engines"]
forked_engines = forked.forked_engines
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CAN_FORK, reason="kills engines with SIGKILL"),
]


@contextmanager
def folders(home: Path) -> Iterator[str]:
    yield home.as_uri()


@contextmanager
def s3(home: Path) -> Iterator[str]:
    moto = pytest.importorskip("moto.server", reason="moto[server] is not installed")
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = moto.ThreadedMotoServer(port=0, ip_address="127.0.0.1")
    server.start()
    host, port = server.get_host_and_port()
    keys = dict.fromkeys(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"), "test")
    place = {"AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_DEFAULT_REGION": "us-east-1"}
    try:
        with mock.patch.dict(os.environ, keys | place):
            file_system("s3://museum")[0].mkdir("museum")
            yield "s3://museum"
    finally:
        server.stop()


def at_random(rng: random.Random) -> Any:
    """Fails so many calls in some way."""
    lock = threading.Lock()

    def fault(name: str) -> Fault | None:
        with lock:
            if rng.random() < FAILS:
                return rng.choice(MOMENTS), rng.choice(list(ERRORS))
            return None

    return fault


@contextmanager
def killed_engines(rng: random.Random, kills: list[int]) -> Iterator[None]:
    """Kill some engines a while after their start."""
    real = forked.FORKED.Popen

    def begin(*given: Any, **more: Any) -> Any:
        engine = real(*given, **more)
        if rng.random() < KILLED:
            threading.Timer(rng.uniform(0.05, 2.5), kill, [engine.pid]).start()
        return engine

    def kill(process: int) -> None:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
            kills.append(process)

    with mock.patch.object(forked.FORKED, "Popen", begin):
        yield


@pytest.mark.parametrize("store", [folders, s3])
def test_failing_at_random(
    store: Any, tmp_path: Path, forked_engines: None, capsys: pytest.CaptureFixture[str]
) -> None:
    write_project(tmp_path / "scan", names=[f"{k}.png" for k in range(8)], dots=True)
    table = str(tmp_path / "museum.toml")
    Path(table).write_text(TABLE, encoding="utf-8")
    assert main(["batch", table, "--run-dir", str(tmp_path / "hand")]) == 0
    wanted = of_batch(tmp_path / "hand")
    ends, kills, wrong = Counter[int](), list[int](), list[str]()
    assert Lease.__init__.__kwdefaults__
    with store(tmp_path / "store") as url, mock.patch.dict(Lease.__init__.__kwdefaults__, LEASES):
        count = int(os.environ.get("ROIGS_TEST_BATCHES", BATCHES))
        for number in range(count):
            rng, runs = random.Random(f"{SEED}/{number}"), f"{url}/runs-{number}"
            capsys.readouterr()
            with (
                mock.patch.dict(os.environ, {"ROIGS_CACHE": str(tmp_path / f"{number}")}),
                failing(at_random(rng)),
                killed_engines(rng, kills),
            ):
                tries, status = 0, 2
                while status != 0 and tries < MOST_TRIES:
                    status = main(["batch", table, "--run-dir", runs, "--jobs", "2"])
                    said = capsys.readouterr().err
                    errors = [line for line in said.splitlines() if line.startswith("error: ")]
                    assert status in (0, 2) and len(errors) == (status == 2), said
                    assert "Traceback" not in said and "Error:" not in said, said
                    tries += 1
            assert status == 0, said
            ends[tries] += 1
            with mock.patch.dict(os.environ, {"ROIGS_CACHE": str(tmp_path / f"{number}")}):
                got = of_batch(fetched(tmp_path / f"got-{number}", runs))
            names = got.keys() | wanted.keys()
            wrong += [f"{runs}: {name}" for name in names if got.get(name) != wanted.get(name)]
            with capsys.disabled():
                print(f"{store.__name__} {number + 1}: {dict(ends)}, {len(kills)} kills", wrong)
    assert not wrong


def fetched(folder: Path, runs: str) -> Path:
    """A batch's run and outputs, copied from a store."""
    found, place = file_system(runs)
    stored_run(runs, "hall").fetch(folder / "hall")
    found.get(f"{place}/outputs/", f"{folder / 'outputs'}/", recursive=True)
    return folder


def of_batch(folder: Path) -> dict[str, object]:
    """The content of a batch's run and outputs, by file."""
    return contents(folder / "hall") | contents(folder / "outputs")
