"""Output that fails: no traceback, a documented exit status, and no harm to the work."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from roigs_engine.commands.stopping import StopRequest
from roigs_engine.commands.streams import Stream
from tests import warm_engine
from tests.engine.commands.command_line import BOX, ROOT, python, start
from tests.engine.synthetic_colmap import Project

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a POSIX shell")
NEEDS_FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux's full device")
CLOSED = (">&-", "2>&-", "<&-", ">&- 2>&- <&-", ">&- <&-")


def shell(text: str, *arguments: object, cold: bool = True) -> subprocess.CompletedProcess[str]:
    """A line for a shell in which `engine` stands for the command line with these arguments."""
    new = [sys.executable, "-m", "roigs_engine", *map(str, arguments)]
    command = new if cold else warm_engine.command(arguments)
    return subprocess.run(
        ["sh", "-c", text.replace("engine", '"$@"'), "sh", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def fine(result: subprocess.CompletedProcess[str]) -> bool:
    """Whether nothing was said that people do not understand."""
    return not any(word in result.stderr for word in ("Traceback", "ignored", "Errno"))


@pytest.mark.parametrize("options", [[], ["--json"], ["--events"], ["--help"]])
def test_a_reader_that_goes_away(project: Project, options: list[str]) -> None:
    process = start("inspect", project.folder, *options, cold=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    said = process.stderr.read()
    assert said == "" or ("--events" in options and "photos" in said and "Traceback" not in said)
    assert process.wait(60) == 141


@pytest.mark.parametrize("closed", CLOSED)
def test_streams_that_are_closed_from_the_start(project: Project, closed: str) -> None:
    result = shell(f"engine {closed}", "inspect", project.folder)
    assert (result.returncode, result.stderr) == (0, "")
    assert bool(result.stdout) == (closed in ("2>&-", "<&-"))


@NEEDS_FULL
def test_a_full_disk_behind_an_answer(project: Project) -> None:
    for options in ([], ["--help"]):
        result = shell("engine > /dev/full", "inspect", project.folder, *options)
        assert result.returncode == 2 and fine(result)
        assert result.stderr.startswith("error: Cannot write standard output (No space left")
    assert shell("engine 2> /dev/full", "inspect", project.folder).returncode == 0


def training(project: Project, folder: Path) -> list[object]:
    """Arguments of a run of some seconds."""
    request = ["train", project.folder, "--roi", BOX, "--run-dir", folder, "--test-every", 3]
    return [*request, "--threads", 1]


@pytest.mark.parametrize(
    "ends",
    [
        ">&- 2>&- <&-",
        pytest.param("> /dev/full 2>&1", marks=NEEDS_FULL),
        *(pytest.param(ends, marks=pytest.mark.slow) for ends in (">&-", "2>&-", "<&-")),
    ],
)
def test_training_goes_on_without_output(project: Project, tmp_path: Path, ends: str) -> None:
    words = [*training(project, tmp_path), "--steps-factor", 0.002]
    result = shell(f"engine {ends}", *words, cold="&-" in ends)
    assert result.returncode == 0 and fine(result)
    assert (tmp_path / "result.ply").exists()


@pytest.mark.parametrize("ctrl_c", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_progress_bar_whose_reader_goes_away(
    project: Project, tmp_path: Path, ctrl_c: bool
) -> None:
    """As `run ... 2>&1 | tee log`: Ctrl-C ends tee first."""
    process = start(*training(project, tmp_path), "--steps-factor", 30)
    assert process.stderr is not None
    while "loss" not in process.stderr.read(64):
        assert process.poll() is None
    process.stderr.close()
    if ctrl_c:
        process.send_signal(signal.SIGINT)
    assert process.wait(60) == 3
    assert list(tmp_path.glob("stages/scene-*/checkpoint.bin"))


def piped(stop: StopRequest, encoding: str = "utf-8") -> tuple[Stream, int]:
    """A stream into a pipe, and the end to read from."""
    source, sink = os.pipe()
    return Stream(io.FileIO(sink, "w"), encoding, stop), source


def test_text_arrives_in_any_encoding() -> None:
    stream, source = piped(StopRequest(), "ascii")
    print("väse \udce9", file=stream, flush=True)
    assert os.read(source, 99) == b"v\\xe4se \\udce9\n"
    os.close(source)


def test_a_reader_that_is_slow_gets_everything_and_one_that_sleeps_cannot_hinder_a_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stop = StopRequest()
    stream, source = piped(stop)
    os.set_blocking(stream.fileno(), False)  # as some programs leave a pipe
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.extend(iter(lambda: os.read(source, 9999), b"!")))
    reader.start()
    stream.write("a" * 300_000)
    while sum(map(len, got)) < 300_000:
        time.sleep(0.01)
    stream.write("!")
    reader.join(10)
    monkeypatch.setattr(stream, "_patience", 0)
    stop.asked = True
    stream.write("b" * 300_000)
    assert stream.lost is not None and stream.lost.errno == errno.ETIMEDOUT and stream.gone
    stream.write("c")
    os.close(source)


@NEEDS_FULL
def test_a_disk_that_is_full_for_a_while_tears_one_line() -> None:
    stop = StopRequest()
    stream, source = piped(stop)
    with open("/dev/full", "wb") as full:
        place = os.dup(stream.fileno())
        os.dup2(full.fileno(), stream.fileno())
        stream.write("one\n")
        os.dup2(place, stream.fileno())
        os.close(place)
    stream.write("two\n")
    stream.write("three\n")
    assert os.read(source, 99) == b"\ntwo\nthree\n"
    assert stream.lost is not None and not stream.gone and not stop.asked
    os.close(source)


def test_a_run_behind_nohup_outlives_its_terminal() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    stop = StopRequest()
    stop.watch_signals()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not stop.asked
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


STOPPING = "Stopping; finished work is saved."
AGAIN = "Press Ctrl-C again to quit at once, without saving."


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["SIGINT"], [f"{STOPPING} {AGAIN}"]),
        (["SIGTERM", "SIGTERM"], [STOPPING]),
        (["SIGHUP", "SIGTERM"], [STOPPING]),
        (["SIGTERM", "SIGINT"], [STOPPING, AGAIN]),
    ],
)
def test_only_who_presses_ctrl_c_is_told_to_press_it_again(
    names: list[str], said: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    stop = StopRequest()
    stop.watch_signals()
    for name in names:
        os.kill(os.getpid(), getattr(signal, name))
    assert stop.asked and not stop.leaving
    assert capsys.readouterr().err.splitlines() == said


@pytest.mark.parametrize("presses", [1, 2, 4])
def test_ctrl_c_while_the_engine_starts(project: Project, presses: int) -> None:
    """Pressed from the first line of its own on; before that, it is Python's."""
    code = f"""
import os, signal, sys, threading, time
def press():
    for _ in range({presses}):
        time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)
sys.argv = ["roigs_engine", "inspect", {str(project.folder)!r}]
signal.signal(signal.SIGINT, signal.SIG_DFL)
from roigs_engine.__main__ import _main
from roigs_engine.commands import process
finished = process._finished
def begin(*arguments):
    threading.Thread(target=press, daemon=True).start()
    return finished(*arguments)
process._finished = begin
process.run_process(_main)
"""
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "Traceback" not in result.stderr and "ignored" not in result.stderr
    lines = result.stderr.splitlines()
    assert lines[0].startswith("Stopping") and lines[1].startswith("Stopped.")
    assert len(lines) == 2 and result.returncode == (3 if presses == 1 else 130)


@pytest.mark.parametrize("streams", ["ascii", "latin-1", ""])
def test_names_in_a_locale_without_letters(
    project: Project, tmp_path: Path, streams: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (
        ("LC_ALL", "C"),
        ("PYTHONUTF8", "0"),
        ("PYTHONCOERCECLOCALE", "0"),
        ("PYTHONIOENCODING", streams),
    ):
        monkeypatch.setenv(name, value)
    box = BOX.replace("thing", "väse 模")
    words = ("select", project.folder, "--roi", box, "--out", tmp_path / "ä", "--events")
    result = python(*words, cold=True)
    assert result.returncode == 0, result.stderr
    path = tmp_path / "ä" / "väse 模.json"
    assert path.exists()
    assert json.loads(result.stdout.splitlines()[-1])["outputs"] == {"väse 模": str(path)}
    # People read what their streams can show.
    seen = {"ascii": "v\\xe4se \\u6a21", "latin-1": "v\ufffdse \\u6a21"}.get(streams, "väse 模")
    assert seen in result.stderr
