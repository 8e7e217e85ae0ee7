"""`batch --cluster` on a real Ray: two machines of one core each, all on loopback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.batch import ray_executor, ray_tasks
from roigs_engine.batch.engine_process import STOPPED, Outcome
from roigs_engine.batch.parts import Part
from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import ConfigError
from tests.engine.batch.clusters import EACH, a_cluster, engines
from tests.engine.batches import contents
from tests.engine.commands.command_line import BOX, refused, start
from tests.engine.synthetic_colmap import write_project

SCENES = ("hall", "attic")
TABLE = """\
[defaults]
roi = ["{box}"]
steps-factor = 0.03
test-every = 4
device = "cpu"
"""


@pytest.fixture(scope="module")
def head() -> Iterator[Any]:
    """A cluster that may be its head alone."""
    with a_cluster(second=False) as made:
        yield made


@pytest.fixture(scope="module")
def cluster(head: Any) -> Any:
    head.second = head.add_node(**EACH)
    return head


@pytest.fixture
def table(tmp_path: Path) -> Path:
    lines = [TABLE.format(box=BOX)]
    for name in SCENES:
        names = [f"{k}.png" for k in range(8)]
        write_project(tmp_path / name, names=names, dots=True)
        lines.append(f"[scenes.{name}]\nscene = '{name}'\n")
    path = tmp_path / "museum.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def events(batch: subprocess.Popen[str]) -> Iterator[dict[str, Any]]:
    assert batch.stdout is not None
    return map(json.loads, batch.stdout)


def kill_engines(run: Path, spared: list[int], told: threading.Event) -> None:
    """Kill engines as they start, before they can have done their part, until one's end is told.

    Not at events of theirs: these come late, so that several would hit the same part, or none.
    """
    until, known = time.monotonic() + 120, set(spared)
    while not told.wait(0.02):
        assert time.monotonic() < until, "the end of no engine was told"
        for process in set(engines(run)) - known:
            known.add(process)
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)


def same_by_hand(run: Path, name: str, folder: Path) -> None:
    """A scene's run folder in a batch has what its row gives when it is run here."""
    options = run / "rows" / f"{name}.json"
    assert main(["run", str(options), "--run-dir", str(folder / name)]) == 0
    assert contents(run / name) == contents(folder / name)


@pytest.mark.slow
def test_a_batch_is_as_here(cluster: Any, table: Path, tmp_path: Path) -> None:
    text = table.read_text(encoding="utf-8")
    table.write_text(text.replace("steps-factor = 0.03", "steps-factor = 0.005"), encoding="utf-8")
    run = tmp_path / "run"
    assert main(["batch", str(table), "--run-dir", str(run), "--cluster", cluster.address]) == 0
    same_by_hand(run, "hall", tmp_path / "by hand")
    assert (run / "attic" / "result.ply").is_file()


@pytest.mark.slow
def test_killed_drivers_engines_and_machines(
    cluster: Any, table: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    run = tmp_path / "run"
    options = ("batch", table, "--run-dir", run, "--cluster", cluster.address, "--events")
    with start(*options, cold=True) as batch:  # the driver is killed
        for event in events(batch):
            if event["event"] == "progress":
                batch.kill()
                break
    orphans = engines(run)  # nobody reports their end
    said: list[dict[str, Any]] = []
    told, removed = threading.Event(), threading.Event()

    def follow() -> None:
        for event in events(batch):
            said.append(event)
            text = event["text"] if event["event"] == "message" else ""
            if "ended by signal 9" in text and "tried again" in text:
                told.set()
            if event["event"] == "stagestarted" and told.is_set() and not removed.is_set():
                removed.set()
                cluster.remove_node(cluster.second, allow_graceful=False)
                request.addfinalizer(lambda: setattr(cluster, "second", cluster.add_node(**EACH)))

    with start(*options, "--retries", 20) as batch:  # then engines, then a machine
        reader = threading.Thread(target=follow)
        reader.start()
        kill_engines(run, orphans, told)
        reader.join()
        assert batch.stderr is not None
        errors = batch.stderr.read()
        assert batch.wait(60) == 0, errors
    assert removed.is_set() and "Traceback" not in errors
    whole = [event for event in said if event.get("stage") == "batch"]
    assert whole[-1]["step"] == whole[-1]["total"] == 2
    for name in SCENES:
        same_by_hand(run, name, tmp_path / "by hand")


@pytest.mark.slow
def test_one_part_can_be_stopped_to_go_on_elsewhere(
    cluster: Any, table: Path, tmp_path: Path
) -> None:
    sign = tmp_path / "batch.lock"
    sign.touch()
    options = ["run", str(tmp_path / "hall"), "--roi", BOX, "--run-dir", str(tmp_path / "one")]
    part = Part(scene="hall", name="all", argv=(*options, "--device", "cpu"))
    executor = ray_executor.RayExecutor(cluster.address, sign, Context())
    try:
        executor.start(part, 0)
        outcome = None
        while outcome is None:
            for found, report in executor.wait(0.5):
                assert found == part
                if isinstance(report, Outcome):
                    outcome = report
                elif report["event"] == "progress":
                    executor.stop(part)
        assert outcome.state == STOPPED and outcome.node
        assert executor.can_move((outcome.node,))  # to the other one
    finally:
        executor.close()


@pytest.mark.slow
def test_a_machine_without_the_gpu_that_it_promised(
    cluster: Any, table: Path, tmp_path: Path
) -> None:
    text = table.read_text(encoding="utf-8").replace('device = "cpu"', "")
    for name, device in zip(SCENES, ("cuda", "auto"), strict=True):
        text = text.replace(f"scene = '{name}'", f"scene = '{name}'\ndevice = '{device}'")
    table.write_text(text, encoding="utf-8")
    promises = cluster.add_node(**EACH, num_gpus=1)
    run = tmp_path / "run"
    try:
        with start("batch", table, "--run-dir", run, "--cluster", cluster.address) as batch:
            out, errors = batch.communicate(timeout=200)
    finally:
        cluster.remove_node(promises)
    hall, attic = SCENES
    assert batch.returncode == 2 and "Traceback" not in errors, errors
    assert f"failed: {hall}: " in out and "CUDA" in out, errors
    assert (run / attic / "result.ply").is_file()  # on the CPU
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "1 of 2 objects done" in page and f"failed: {hall}: " in page


@pytest.mark.slow  # a cluster starts; `misfit`, above, has the words
def test_machines_with_another_version_are_refused(
    head: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign = tmp_path / "batch.lock"
    sign.touch()
    said: list[str] = []
    context = Context(emit=lambda event: said.append(event.text))  # type: ignore[union-attr]
    monkeypatch.setattr(ray_executor, "__version__", "99.0")
    with pytest.raises(ConfigError, match="No machine of the Ray cluster"):
        ray_executor.RayExecutor(head.address, sign, context)
    assert said and all("is not used: it has roigs" in text for text in said)
    monkeypatch.undo()
    said.clear()
    with pytest.raises(ConfigError, match="No machine"):
        ray_executor.RayExecutor(head.address, tmp_path / "elsewhere" / "batch.lock", context)
    assert said and all("does not see" in text for text in said)


@pytest.mark.slow
def test_machines_that_do_not_answer_yet_are_waited_for(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign = tmp_path / "batch.lock"
    sign.touch()
    said: list[str] = []
    context = Context(emit=lambda event: said.append(event.text))  # type: ignore[union-attr]
    really, asked = ray_executor.RayExecutor._problem, 0

    def problem(self: ray_executor.RayExecutor, reference: Any) -> tuple[str, bool]:
        nonlocal asked
        asked += 1
        return really(self, reference) if asked > 5 else ("does not answer", True)

    monkeypatch.setattr(ray_executor.RayExecutor, "_problem", problem)
    ray_executor.RayExecutor(cluster.address, sign, context).close()
    assert asked > 5 and not said
    asked = 0
    monkeypatch.setattr(ray_executor, "REFRESH", 0.0)
    ray_executor.RayExecutor(cluster.address, sign, context).close()
    assert said and all("is not used: it does not answer" in text for text in said)


@pytest.mark.slow
def test_heads_without_cores_do_no_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part that fails elsewhere would wait for one for ever."""
    sign = tmp_path / "batch.lock"
    sign.touch()
    part = Part(scene="hall", name="all", argv=())
    said: list[str] = []
    context = Context(emit=lambda event: said.append(event.text))  # type: ignore[union-attr]
    with a_cluster(num_cpus=0) as cluster:
        executor = ray_executor.RayExecutor(cluster.address, sign, context)
        try:
            assert executor.has_capacity(part) and not said
            assert not executor.can_move((cluster.second.node_id,))
        finally:
            executor.close()
        cluster.remove_node(cluster.second)
        monkeypatch.setattr(ray_executor, "LOOK_SECONDS", 1.0)
        with pytest.raises(ConfigError, match="No machine"):
            ray_executor.RayExecutor(cluster.address, sign, context)
    assert said == ["No machine of the Ray cluster has a free core; waiting for one."]


def test_what_a_part_asks_for_is_on_one_machine() -> None:
    many = {"CPU": 32.0, "memory": 8e9}
    large, card = {"CPU": 4.0, "memory": 64e9}, {"CPU": 8.0, "memory": 16e9, "GPU": 1.0}
    nodes = [many, large, card]

    def asked(memory: float, *, gpu: bool = False, parts: int = 1) -> tuple[int, int]:
        part = Part(scene="hall", name="all", argv=(), memory=int(memory), gpu=gpu)
        wanted = ray_executor.demand(part, nodes, parts)
        assert wanted["memory"] <= memory
        return wanted["num_cpus"], wanted["num_gpus"]

    assert asked(4e9) == (32, 0)
    assert asked(40e9) == asked(400e9) == (4, 0)
    assert asked(4e9, gpu=True) == (8, 1)
    nodes = [{"CPU": 16.0}, {"CPU": 8.0}]  # an even share, 12, leaves the small one idle
    assert [asked(0, parts=n)[0] for n in (1, 2, 3, 4, 24, 99)] == [16, 8, 8, 5, 1, 1]


def test_what_a_machine_needs() -> None:
    assert not ray_tasks.misfit({"version": "1", "sees": True}, "1", "/runs/batch.lock")
    assert "install the same" in ray_tasks.misfit({"version": "1", "sees": True}, "2", "/x/y")
    assert "/runs;" in ray_tasks.misfit({"version": "1", "sees": False}, "1", "/runs/batch.lock")


def test_no_cluster_is_one_line(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ("batch", table, "--run-dir", tmp_path / "run", "--cluster")
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    assert "needs Ray, which is not installed" in refused(capsys, *options, "local")
    monkeypatch.undo()
    pytest.importorskip("ray", reason="Ray is not installed (the extra `cluster`)")
    assert "no Ray cluster at 127.0.0.1:1 " in refused(capsys, *options, "127.0.0.1:1")
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    services = "ray._private.services"  # which may find the one of another test
    monkeypatch.setattr(f"{services}.find_gcs_addresses", cache(lambda: ()))
    monkeypatch.setattr(f"{services}.find_bootstrap_address", lambda *_: None)
    line = refused(capsys, *options, "auto")
    assert "this machine belongs to no Ray cluster" in line and "use --cluster local" in line
    assert "is no address" in refused(capsys, *options, "museum")
    run = ("run", tmp_path / "hall", "--roi", BOX, "--run-dir", tmp_path / "one", "--cluster", "x")
    assert "--threads is for this machine" in refused(capsys, *run, "--threads", 2)
    assert "--part is for one machine" in refused(capsys, *run, "--part", "scene")
    assert "is no address" in refused(capsys, *run)


@pytest.mark.slow
def test_one_run_is_as_here(cluster: Any, table: Path, tmp_path: Path) -> None:
    scene, folders = tmp_path / "hall", (tmp_path / "there", tmp_path / "here")
    options = ["run", scene, "--roi", BOX, "--steps-factor", 0.005, "--test-every", 4]
    options = [str(word) for word in (*options, "--compare", "--device", "cpu", "--run-dir")]
    with start(*options, folders[0], "--cluster", cluster.address, "--events") as engine:
        said = list(events(engine))
        assert engine.wait(60) == 0
    stages = {event["stage"] for event in said if event["event"] == "progress"}
    assert {"scene", "joint", "evaluate"} <= stages
    assert said[-1]["outputs"]["result"] == str(folders[0] / "result.ply")
    assert main([*options, str(folders[1])]) == 0
    there, here = map(contents, folders)
    assert there.pop("cluster.json") and there == here
    with start(*options, folders[0], "--cluster", cluster.address, "--seed", 9) as engine:
        assert "--update" in engine.communicate(timeout=200)[1]  # another run is refused
        assert engine.returncode == 2


@pytest.mark.slow
def test_a_head_that_is_killed_is_one_line(cluster: Any, table: Path, tmp_path: Path) -> None:
    """Last: it ends the cluster. `test_kills.py` goes on with another one."""
    text = table.read_text(encoding="utf-8")  # longer than it takes to see that the head is gone
    table.write_text(text.replace("steps-factor = 0.03", "steps-factor = 0.5"), encoding="utf-8")
    options = ("--run-dir", tmp_path / "run", "--cluster", cluster.address, "--events")
    with start("batch", table, *options) as batch:
        for event in events(batch):
            if event["event"] == "progress":
                cluster.head_node.kill_all_processes(check_alive=False, allow_graceful=False)
                break
        *_, last = events(batch)
        assert batch.wait(60) == 2
    assert last["event"] == "failed"
    assert last["message"] == f"The Ray cluster {cluster.address} is gone."
    assert "the same command resumes" in last["hint"]


@pytest.mark.slow
def test_a_ray_of_ones_own_stays_and_is_for_this_machine_alone() -> None:
    """Its programs end with the thread that has started them; others are not to reach it."""
    code = (
        "import time\n"
        "from roigs_engine.batch.ray_connection import Connection\n"
        "connection = Connection('local')\n"
        "time.sleep(3)\n"
        "print([n['NodeManagerAddress'] for n in connection.ask(connection.ray.nodes)])\n"
        "connection.close()\n"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("RAY_")}
    ended = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120
    )
    assert ended.stdout.strip().endswith("['127.0.0.1']"), ended.stderr[-2000:]
