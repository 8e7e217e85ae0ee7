"""Trainings that are stopped or killed, with the real engine."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.engine.process import EngineProcess
from tests.addon.fake_engine import alive, until
from tests.addon.other_blender import engine_pid, other_blender
from tests.addon.scenes import ROOT
from tests.machine_load import Waited

pytestmark = pytest.mark.blender
TRAINING = '{"event": "progress", "stage": "scene"'


def checkpoints(folder: Path) -> list[Path]:
    return list(folder.glob("stages/*/checkpoint.bin"))


def training(state) -> bool:
    return state.stage in ("scene", "joint") and state.step > 0


@pytest.fixture
def long_run(blender: ModuleType, engine, project: Path, tmp_path: Path):
    """A training that takes a minute at least, with the operator's own spec: its job."""
    from roigs_addon.jobs import current
    from tests.addon.scenes import ready, start_training

    scene = ready(blender, project, tmp_path / "run", factor=10.0)
    job = start_training(engine, scene)
    state = current.state()
    assert until(lambda: not job.poll() or training(state), 60), state.error
    assert job.poll(), state.error
    yield scene, job
    if current.busy():
        job.process.kill()
        job.process.wait()


def test_stop_answers_within_two_seconds(blender: ModuleType, long_run, tmp_path: Path) -> None:
    from roigs_addon.jobs import current
    from tests.addon.scenes import status

    scene, job = long_run
    state = current.state()
    waited = Waited()
    assert blender.ops.roigs.stop() == {"FINISHED"}
    assert until(lambda: not job.poll(), 30)
    assert waited.at_most(2)
    assert job.result.stopped and not job.result.failed
    assert state.error == "" and state.message.startswith("Stopped")
    assert checkpoints(tmp_path / "run") and status(scene).left
    assert not (tmp_path / "run" / "result.ply").exists() and not current.busy()
    assert not blender.ops.roigs.stop.poll()


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_killed_engine_is_an_error(blender: ModuleType, long_run) -> None:
    from roigs_addon.jobs import current

    _, job = long_run
    os.kill(job.process.pid, signal.SIGKILL)
    assert until(lambda: not job.poll(), 10)
    state = current.state()
    assert "signal 9" in state.error and "\n" not in state.error
    assert job.result.failed and not current.busy()


BLENDER_SCRIPT = """
import sys, json
sys.path.insert(0, {root!r})
import bpy, roigs_addon
bpy.ops.wm.read_factory_settings(use_empty=True)
roigs_addon.register()
from pathlib import Path
from tests.addon.scenes import ready
from roigs_addon.jobs import current
start = current.start
def noted(engine, spec):
    job = start(engine, spec)
    print("PID", spec.title, job.process.pid, flush=True)
    return job
current.start = noted
ready(bpy, Path({project!r}), Path({run!r}), factor={factor})
print("TRAIN", bpy.ops.roigs.train_roi(), flush=True)
roigs_addon.unregister()
"""


def blender_process(folder: Path, project: Path, factor: float) -> subprocess.Popen[str]:
    """Another Blender like this one that trains in folder/run."""
    values = {"root": str(ROOT), "project": str(project), "run": str(folder / "run")}
    return other_blender(folder, BLENDER_SCRIPT.format(**values, factor=factor))


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_no_engine_outlives_a_killed_blender(engine, project: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with blender_process(tmp_path, project, 10.0) as process:
        pid = engine_pid(process, "Training")
        events = run / "events.jsonl"
        trains = until(lambda: events.is_file() and TRAINING in events.read_text(), 60)
        lives = alive(pid)
        process.kill()  # whatever was found: it trains for minutes
    assert trains and lives
    assert until(lambda: not alive(pid), 5)
    assert checkpoints(run)
    arguments = ["train", str(run / "blender" / "train.json"), "--run-dir", str(run)]
    resumed = EngineProcess(engine, arguments)
    said: list[object] = []

    def says_so() -> bool:
        said.extend(resumed.events())
        return any("resumes at" in str(event) for event in said)

    assert until(says_so, 240)
    resumed.stop()
    assert resumed.wait(60) and resumed.result().stopped
