"""Events, and a command that is stopped."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.exchange import formats
from roigs_engine.exchange.usd_probe import TOO_LARGE
from roigs_engine.formats.events import Message, Progress, to_json
from tests.engine.commands.command_line import BOX, EMPTY, python, refused, start
from tests.engine.runs import checkpoint_step, stage_of
from tests.engine.synthetic_colmap import Project
from tests.warm_engine import CAN_FORK


def events(result: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    """Standard output with --events: JSON lines and nothing else."""
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_every_event_is_one_line_of_strict_json() -> None:
    nan = float("nan")
    progress = Progress(
        stage="a", step=1, total=2, loss=nan, psnr=-nan, gaussians=3, seconds_left=float("inf")
    )
    record = json.loads(to_json(progress), parse_constant=pytest.fail)
    assert record["event"] == "progress"
    assert record["step"] == 1
    assert record["loss"] is record["psnr"] is record["seconds_left"] is None
    line = to_json(Message(text="two\nlines, '模型'"))
    assert "\n" not in line and "模型" in line


def test_events_end_in_done(project: Project) -> None:
    result = python("select", project.folder, "--roi", BOX, "--events")
    assert result.returncode == 0
    assert events(result)[-1] == {"event": "done", "outputs": {}, "stopped": False}


def test_a_failure_is_an_event(project: Project) -> None:
    result = python("select", project.folder, "--roi", EMPTY, "--events")
    assert result.returncode == 2
    last = events(result)[-1]
    assert last["event"] == "failed"
    assert "'nothing'" in last["message"]
    assert last["hint"]
    assert "Traceback" not in result.stderr


def train(project: Project, folder: Path) -> subprocess.Popen[str]:
    """A training run in its first stage, with a preview every moment."""
    process = start(
        *("train", project.folder, "--roi", BOX, "--run-dir", folder, "--test-every", 3),
        *("--events", "--threads", 1, "--preview-seconds", 0.01),
    )
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["event"] == "preview":
            return process
    raise AssertionError(process.communicate()[1])


def scene_step(folder: Path) -> int:
    return checkpoint_step(stage_of(folder, "scene") / "checkpoint.bin")


@pytest.mark.parametrize("text", ["stop\n", ""])
def test_a_stop_or_the_end_of_input_stops_training(
    project: Project, tmp_path: Path, text: str
) -> None:
    folder = tmp_path / "run"
    process = train(project, folder)
    out, err = process.communicate(text, timeout=60)
    assert process.returncode == 3, err
    lines = [json.loads(line) for line in out.splitlines()]
    assert lines[-1] == {"event": "done", "outputs": {}, "stopped": True}
    assert (folder / "preview.ply").stat().st_size > 0
    assert scene_step(folder) > 0
    log = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(log[-1])["event"] == "done"
    assert not (folder / "run.lock").exists()


def test_the_log_has_every_event(project: Project, tmp_path: Path) -> None:
    folder, command = tmp_path / "run", ("train", project.folder, "--roi", BOX, "--events")
    tiny = ("--steps-factor", 0.003, "--test-every", 3, "--device", "cpu", "--threads", 1)
    shutil.copytree(project.folder / "sparse" / "0", project.folder / "sparse" / "1")
    first = python(*command, "--run-dir", folder, *tiny)
    assert first.returncode == 0, first.stderr
    log = folder / "events.jsonl"
    device, said = first.stdout.splitlines()[:2]
    assert json.loads(device)["event"] == "device"
    assert "has 2 models" in said  # before the folder is looked at
    assert log.read_text(encoding="utf-8") == first.stdout
    second = python(*command, "--run-dir", folder, *tiny)
    assert log.read_text(encoding="utf-8") == first.stdout + second.stdout
    other = python(*command, "--run-dir", folder, *tiny, "--seed", 1)
    assert other.returncode == 2
    assert log.read_text(encoding="utf-8") == first.stdout + second.stdout
    shutil.rmtree(project.folder / "sparse" / "1")


def test_a_run_outlives_nobody_and_leaves_a_checkpoint(project: Project, tmp_path: Path) -> None:
    """Both pipes break at once, as when the parent was killed."""
    folder = tmp_path / "run"
    process = train(project, folder)
    for pipe in (process.stdin, process.stdout, process.stderr):
        assert pipe is not None
        pipe.close()
    assert process.wait(60) == 3
    assert scene_step(folder) > 0


def test_a_second_engine_is_refused(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    process = train(project, folder)
    pid = json.loads((folder / "run.lock").read_text(encoding="utf-8"))["pid"]
    assert CAN_FORK or pid == process.pid
    second = ("train", project.folder, "--roi", BOX, "--run-dir", folder, "--test-every", 3)
    assert f"process {pid}" in refused(capsys, *second)
    os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))  # the engine, and not who waits for it
    process.communicate()
    assert (folder / "run.lock").exists()
    # What a dead process has left does not hold up the next one.
    train(project, folder).communicate("stop\n", timeout=60)
    assert not (folder / "run.lock").exists()


def test_a_stop_while_loading_is_answered(project: Project, tmp_path: Path) -> None:
    process = start("export", project.folder, "--out", tmp_path / "out", "--events")
    out, _ = process.communicate("stop\n", timeout=60)
    assert process.returncode in (0, 3)  # 0: it was done before the line was read
    assert json.loads(out.splitlines()[-1])["stopped"] == (process.returncode == 3)


def test_work_of_a_library_returns_raises_and_can_be_left() -> None:
    stop = StopRequest()
    context = Context(should_stop=lambda: stop.asked)
    assert context.interruptible(lambda: 5) == 5
    with pytest.raises(ZeroDivisionError):
        context.interruptible(lambda: 1 // 0)

    def long() -> None:
        stop.asked = True
        time.sleep(20)

    began = time.monotonic()
    with pytest.raises(Stopped):
        context.interruptible(long)
    assert time.monotonic() - began < 5


@pytest.mark.parametrize("damaged", [False, True])
def test_a_stop_is_heard_while_a_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damaged: bool
) -> None:
    """It took up to a minute, and a damaged file ended with status 2."""
    stop = StopRequest()
    source = tmp_path / "a.splat"
    source.write_bytes(bytes(64))

    def read(path: Path, check: object) -> None:
        stop.asked = True
        time.sleep(0 if damaged else 20)
        raise RunFolderError("It is damaged.")

    monkeypatch.setattr(formats, "read", read)
    began = time.monotonic()
    assert main(["convert", str(source), str(tmp_path / "b.ply")], stop) == 3
    assert time.monotonic() - began < 10
    assert not (tmp_path / "b.ply").exists()


def test_a_stop_is_heard_while_a_photo_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was decoded to the end, written, and the status was 0."""
    stop, photo = StopRequest(), tmp_path / "a.png"
    Image.new("RGB", (8, 8)).save(photo)

    def decoded(*given: object) -> None:
        stop.asked = True
        time.sleep(20)

    monkeypatch.setattr("roigs_engine.photos.decode.decode", decoded)
    assert main(["show-photo", str(photo), "--out", str(tmp_path / "b.jpg")], stop) == 3
    assert not (tmp_path / "b.jpg").exists()


def test_a_look_into_openusd_ends_with_who_waits_for_it() -> None:
    code = "from roigs_engine.exchange import usd_probe; usd_probe.end_with_parent()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    assert child.stdin is not None
    child.stdin.close()
    assert child.wait(20) == TOO_LARGE
