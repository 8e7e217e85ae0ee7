"""Engine processes: events, ends, stopping; without Blender."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import pytest

from roigs_addon.engine.command import Engine
from roigs_addon.engine.process import EngineProcess
from roigs_engine.formats.events import parse_event
from tests.addon.fake_engine import LISTEN, fake, finished, until

BROKEN = [
    "",
    "\n",
    "text",
    "{",
    "[]",
    "null",
    "1",
    '"progress"',
    '{"event": "unknown"}',
    '{"event": ["progress"]}',
    '{"event": null}',
    '{"evnt": "progress"}',
    "[" * 100_000,
    '{"event": "progress"',
    "\x00\ufffd",
]


@pytest.mark.parametrize("line", BROKEN, ids=lambda line: repr(line[:20]))
def test_lines_that_are_not_events(line: str) -> None:
    assert parse_event(line) is None


def test_events_are_taken_and_text_goes_to_the_log(tmp_path: Path) -> None:
    engine = fake(
        tmp_path,
        """
        say(event="stagestarted", stage="scene", total=3)
        print("Zwischentext 庭")
        print("{", flush=True)
        print("for people", file=sys.stderr, flush=True)
        sys.stdout.buffer.write(b"\\xff\\xfe broken\\n")
        sys.stdout.flush()
        say(event="message", text="17 photos left out")
        say(event="progress", stage="scene", step=1, total=3, loss=0.12345, gaussians=70)
        say(event="preview", path="p.ply")
        say(event="progress", stage="scene", step=2, total=3)
        say(event="done", outputs={"result": "a.ply"}, stopped=False)
        """,
    )
    process = EngineProcess(engine, ["train"], log=tmp_path / "a" / "log.txt")
    result, events = finished(process)
    assert [event["event"] for event in events] == []  # taken by `result`
    assert (result.status, result.failed, result.stopped) == (0, False, False)
    assert result.outputs == {"result": "a.ply"}
    log = (tmp_path / "a" / "log.txt").read_text(encoding="utf-8")
    assert "Zwischentext 庭" in log and "for people" in log and "broken" in log
    told = [line[10:] for line in log.splitlines()]
    for line in ("scene: 3 steps", "17 photos left out", "Done."):
        assert line in told
    progress = [line for line in told if line.startswith("scene: ") and " of " in line]
    assert progress == ["scene: 1 of 3, loss 0.123, gaussians 70"]  # the second came too soon


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            'say(event="failed", message="No photos.", hint="Add some."); sys.exit(2)',
            "No photos. Add some.",
        ),
        ('say(event="failed", message=None); sys.exit(2)', "The engine failed."),
        ('print("a\\nboom", file=sys.stderr); sys.exit(7)', "The engine ended with status 7: boom"),
        ("sys.exit(0)", "The engine ended with status 0"),
        ("os.kill(os.getpid(), 9)", "ended from outside (signal 9)"),
        ('raise ValueError("broken")', "ValueError: broken"),
    ],
)  # fmt: skip
def test_every_end_has_a_message(tmp_path: Path, code: str, message: str) -> None:
    result, _ = finished(EngineProcess(fake(tmp_path, code), ["train"]))
    assert result.failed and message in result.message and "\n" not in result.message


@pytest.mark.parametrize("outputs", ["null", "[]", '"a"', "{}"])
def test_odd_outputs(tmp_path: Path, outputs: str) -> None:
    engine = fake(tmp_path, f"""print('{{"event": "done", "outputs": {outputs}}}')""")
    result, _ = finished(EngineProcess(engine, ["train"]))
    assert not result.failed and result.outputs == {}


def test_stop_is_the_end_of_input(tmp_path: Path) -> None:
    process = EngineProcess(fake(tmp_path, LISTEN), ["train"])
    assert until(lambda: bool(process.events()))
    process.stop()
    process.stop()
    assert process.wait(5)
    (event,) = process.events()
    assert event["text"] == r"heard ''"
    assert process.result().stopped and not process.result().failed
    process.stop()


def test_a_python_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        EngineProcess(Engine(python=tmp_path / "nowhere", source=tmp_path), ["train"])


def test_the_environment_is_the_engines_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/blenders/own")
    monkeypatch.setenv("PYTHONHOME", "/blenders/own")
    monkeypatch.chdir(tmp_path)  # a folder with a module of an evil name
    (tmp_path / "json.py").write_text("raise SystemExit(9)")
    code = 'say(event="done", outputs=dict(os.environ))'
    result, _ = finished(EngineProcess(fake(tmp_path, code), ["train"]))
    assert result.outputs["PYTHONPATH"] == str(tmp_path / "source")
    assert "PYTHONHOME" not in result.outputs


@pytest.mark.filterwarnings("error")  # as PYTHONWARNINGS=error: Python then prints a traceback
def test_no_pipe_is_left_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    process = EngineProcess(fake(tmp_path, 'say(event="done", outputs={})'), ["train"])
    assert finished(process)[0].status == 0
    del process
    gc.collect()
    assert not lost
