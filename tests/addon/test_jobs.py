"""Engine jobs: events, stopping, deaths; with an engine made for it where that is enough."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.engine.client import Engine, Job, parse_event
from roigs_addon.engine.python import VARIABLE, own_python
from tests.addon.scenes import ROOT

PYTHON = Path(os.environ.get("ROIGS_TEST_PYTHON") or own_python())


def fake(folder: Path, code: str) -> Engine:
    """An engine whose `python -m roigs_engine` runs `code`; `say` prints an event."""
    package = folder / "source" / "roigs_engine"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    head = """
        import json, os, sys, time
        def say(**event):
            print(json.dumps(event), flush=True)
    """
    text = textwrap.dedent(head) + textwrap.dedent(code)
    (package / "__main__.py").write_text(text, encoding="utf-8")
    return Engine(python=PYTHON, source=folder / "source")


def until(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    """Wait for something; was it in time?"""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def finished(job: Job):
    """The outcome and all events."""
    assert until(lambda: not job.running())
    return job.outcome(), job.events()


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


# --- the client, without Blender ---

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
def test_lines_that_are_no_events(line: str) -> None:
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
    job = Job(engine, ["train"], log=tmp_path / "a" / "log.txt")
    outcome, events = finished(job)
    assert [event["event"] for event in events] == []  # taken by `outcome`
    assert (outcome.status, outcome.failed, outcome.stopped) == (0, False, False)
    assert outcome.outputs == {"result": "a.ply"}
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
def test_every_end_has_words(tmp_path: Path, code: str, message: str) -> None:
    outcome, _ = finished(Job(fake(tmp_path, code), ["train"]))
    assert outcome.failed and message in outcome.message and "\n" not in outcome.message


@pytest.mark.parametrize("outputs", ["null", "[]", '"a"', "{}"])
def test_odd_outputs(tmp_path: Path, outputs: str) -> None:
    engine = fake(tmp_path, f"""print('{{"event": "done", "outputs": {outputs}}}')""")
    outcome, _ = finished(Job(engine, ["train"]))
    assert not outcome.failed and outcome.outputs == {}


LISTEN = """
say(event="stagestarted", stage="scene", total=9)
line = sys.stdin.readline()
say(event="message", text="heard " + repr(line), level="info")
say(event="done", outputs={}, stopped=True)
sys.exit(3)
"""


def test_stop_is_the_end_of_input(tmp_path: Path) -> None:
    job = Job(fake(tmp_path, LISTEN), ["train"])
    assert until(lambda: bool(job.events()))
    job.stop()
    job.stop()
    assert job.wait(5)
    (event,) = job.events()
    assert event["text"] == r"heard ''"
    assert job.outcome().stopped and not job.outcome().failed
    job.stop()


def test_a_python_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        Job(Engine(python=tmp_path / "nowhere", source=tmp_path), ["train"])


def test_the_environment_is_the_engines_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/blenders/own")
    monkeypatch.setenv("PYTHONHOME", "/blenders/own")
    monkeypatch.chdir(tmp_path)  # a folder with a module of an evil name
    (tmp_path / "json.py").write_text("raise SystemExit(9)")
    code = 'say(event="done", outputs=dict(os.environ))'
    outcome, _ = finished(Job(fake(tmp_path, code), ["train"]))
    assert outcome.outputs["PYTHONPATH"] == str(tmp_path / "source")
    assert "PYTHONHOME" not in outcome.outputs


# --- jobs in Blender ---


@pytest.fixture
def work(addon: ModuleType, tmp_path: Path):
    """Makes the `Work` of a fake job; `taken` gets its outcome."""
    from roigs_addon import jobs

    taken = []

    def make(**changes: object) -> jobs.Work:
        values = {"title": "Testing", "arguments": ["train"], "log": tmp_path / "log.txt"}
        return jobs.Work(**(values | {"on_done": taken.append} | changes))

    make.taken = taken
    return make


@pytest.mark.blender
def test_progress_becomes_properties(blender: ModuleType, work, tmp_path: Path) -> None:
    from roigs_addon import jobs

    engine = fake(
        tmp_path,
        """
        say(event="stagestarted", stage="scene", total=30)
        say(event="progress", stage="joint", step=12, total=30, loss=0.25, psnr=21.5,
            gaussians=1234, seconds_left=125.4)
        say(event="message", text="Something", level="info")
        say(event="done", outputs={}, stopped=False)
        """,
    )
    runner = jobs.start(engine, work())
    while runner.poll():
        time.sleep(0.02)
    state = blender.context.window_manager.roigs
    assert (state.step, state.total, state.gaussians) == (12, 30, 1234)
    assert (state.loss, state.psnr) == (0.25, 21.5)
    assert len(work.taken) == 1 and not jobs.busy()
    state.stage = "joint"
    text = jobs.progress_text(state)
    assert text == "joint 12 / 30, 21.5 dB, 1,234 Gaussians, 2 min 05 s left"


@pytest.mark.blender
def test_a_job_is_seen_and_stopped_after_a_file_was_loaded(
    blender: ModuleType, work, tmp_path: Path
) -> None:
    from roigs_addon import jobs

    engine = fake(
        tmp_path,
        """
        say(event="stagestarted", stage="scene", total=30)
        say(event="progress", stage="joint", step=12, total=30, gaussians=1234)
        say(event="message", text="Something", level="info")
        sys.stdin.read()
        say(event="done", outputs={}, stopped=True)
        """,
    )
    runner = jobs.start(engine, work())
    runner.hears_esc = True
    window_manager = blender.context.window_manager
    assert until(lambda: runner.poll() and window_manager.roigs.message == "Something")
    blender.ops.wm.read_homefile(use_empty=True)
    state = blender.context.window_manager.roigs
    assert (state.title, state.stage, state.message) == ("Testing", "joint", "Something")
    assert (state.step, state.total, state.gaussians) == (12, 30, 1234)
    assert state.log.endswith("log.txt") and not runner.hears_esc
    assert blender.ops.roigs.stop() == {"FINISHED"}
    blender.ops.wm.read_homefile(use_empty=True)
    assert blender.context.window_manager.roigs.message == jobs.STOPPING
    assert jobs.wait(runner).stopped


@pytest.mark.blender
def test_no_preview_is_drawn_while_the_engine_stops(
    blender: ModuleType, work, tmp_path: Path
) -> None:
    from roigs_addon import jobs

    first, last = tmp_path / "first.ply", tmp_path / "last.ply"
    first.touch()
    last.touch()
    engine = fake(
        tmp_path,
        f"""
        say(event="preview", path={str(first)!r})
        sys.stdin.read()
        say(event="preview", path={str(last)!r})
        time.sleep(0.5)
        say(event="done", outputs={{}}, stopped=True)
        """,
    )
    shown: list[Path] = []
    runner = jobs.start(engine, work(on_preview=shown.append, folder=tmp_path))
    assert until(lambda: runner.poll() and bool(shown))
    runner.stop()
    while runner.poll():
        assert shown == [first]
        time.sleep(0.02)
    assert shown == [first, last] and runner.outcome.stopped


@pytest.mark.blender
def test_odd_numbers_do_no_harm(blender: ModuleType, work, tmp_path: Path) -> None:
    from roigs_addon import jobs

    odd = ["NaN", "Infinity", "-Infinity", "1e400", "-1e30", "9" * 400, '"x"', "null", "[]", "{}"]
    lines = [
        f'{{"event": "{kind}", "stage": {v}, "step": {v}, "total": {v}, "loss": {v}, "psnr": {v},'
        f' "gaussians": {v}, "seconds_left": {v}, "text": {v}, "path": {v}}}'
        for v in odd
        for kind in ("stagestarted", "progress", "message", "preview")
    ]
    (tmp_path / "lines").write_text("\n".join([*lines, '{"event": "progress"}', ""]))
    code = f"print(open({str(tmp_path / 'lines')!r}).read(), flush=True)\nsay(event='done')"
    runner = jobs.start(fake(tmp_path, code), work())
    outcome = jobs.wait(runner)
    assert not outcome.failed and len(work.taken) == 1
    assert jobs.progress_text(blender.context.window_manager.roigs)


@pytest.mark.blender
def test_odd_texts_do_no_harm(blender: ModuleType, work, tmp_path: Path) -> None:
    from roigs_addon import jobs

    odd = ["a\0b", "\ud800", "\udcff", "x" * 60_000, "\x1b[2J", "a\nb", "\u202e", "{}%s"]
    code = "\n".join(
        f"say(event={kind!r}, stage={text!r}, text={text!r}, path={text!r})"
        for text in odd
        for kind in ("stagestarted", "progress", "message", "preview")
    )
    taken: list[Path] = []
    code += "\nsay(event='failed', message='\\ud800 no', hint='a\\0b'); sys.exit(2)"
    given = work(folder=tmp_path, on_preview=taken.append)
    outcome = jobs.wait(jobs.start(fake(tmp_path, code), given))
    assert outcome.failed and "no" in blender.context.window_manager.roigs.error
    assert not taken


@pytest.mark.blender
def test_previews_outside_the_run_are_not_looked_at(
    blender: ModuleType, work, tmp_path: Path
) -> None:
    from roigs_addon import jobs

    run = tmp_path / "run"
    run.mkdir()
    (run / "preview.ply").write_text("mine")
    (tmp_path / "secret").write_text("not mine")
    (run / "link.ply").symlink_to(tmp_path / "secret")
    (run / "loop").symlink_to(run / "loop")
    paths = [tmp_path / "secret", run / ".." / "secret", run / "link.ply", run / "loop", run,
             "/etc/passwd", "/dev/zero", "preview.ply", "a\0b", run / "preview.ply"]  # fmt: skip
    code = "\n".join(f"say(event='preview', path={str(path)!r})" for path in paths)
    taken: list[Path] = []
    for folder, expected in ((run, [run / "preview.ply"]), (None, [])):
        taken.clear()
        given = work(folder=folder, on_preview=taken.append)
        jobs.wait(jobs.start(fake(tmp_path / str(folder is None), code), given))
        assert taken == expected


@pytest.mark.blender
def test_one_job_at_a_time_and_none_outlives_the_addon(
    blender: ModuleType, work, tmp_path: Path
) -> None:
    from roigs_addon import jobs
    from roigs_addon.errors import AddonError

    engine = fake(tmp_path, LISTEN)
    runner = jobs.start(engine, work())
    assert jobs.busy()
    with pytest.raises(AddonError, match="busy"):
        jobs.start(engine, work())
    jobs.unregister()
    assert not alive(runner.job.pid) and not jobs.busy() and not work.taken


@pytest.mark.blender
def test_a_failed_result_is_an_error(blender: ModuleType, work, tmp_path: Path) -> None:
    from roigs_addon import jobs
    from roigs_addon.errors import AddonError

    def refuse(_: object) -> None:
        raise AddonError("It does not fit.")

    engine = fake(tmp_path, 'say(event="done", outputs={})')
    assert jobs.wait(jobs.start(engine, work(on_done=refuse))).message == "It does not fit."
    assert blender.context.window_manager.roigs.error == "It does not fit."

    def fall(_: object) -> None:
        raise RuntimeError("oh")

    assert "oh" in jobs.wait(jobs.start(engine, work(on_done=fall))).message
    assert not jobs.busy()


@pytest.mark.blender
def test_what_is_taken_in_can_be_undone(
    blender: ModuleType, work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a step of its own, after the results are in."""
    from roigs_addon import jobs, undo
    from roigs_addon.errors import AddonError

    steps: list[str] = []
    monkeypatch.setattr(undo, "push", lambda title: steps.append(title))
    engine = fake(tmp_path, 'say(event="done", outputs={})')

    def take(_: object) -> None:
        assert not steps

    def refuse(_: object) -> None:
        raise AddonError("It does not fit.")

    assert not jobs.wait(jobs.start(engine, work(on_done=take))).message
    assert steps == ["Testing"]
    jobs.wait(jobs.start(engine, work(on_done=refuse)))
    jobs.wait(jobs.start(fake(tmp_path / "2", 'say(event="done", stopped=True)'), work()))
    assert steps == ["Testing"]


@pytest.mark.blender
def test_no_undo_step_comes_before_the_results(addon: ModuleType) -> None:
    """Operators that run the engine end before it does when the file browser calls them."""
    from roigs_addon.operators import results, scene, select, train

    for module in (results, scene, select, train):
        for cls in module.CLASSES:
            if issubclass(cls, module.EngineJob):
                assert "UNDO" not in getattr(cls, "bl_options", ())


@pytest.mark.blender
def test_esc_is_offered_where_it_is_heard(
    blender: ModuleType, work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not in an import by the file browser, whose operator has ended."""
    from unittest.mock import MagicMock

    from roigs_addon import jobs, panels

    monkeypatch.setattr(panels, "_say", lambda *_: None)
    runner = jobs.start(fake(tmp_path, LISTEN), work())

    def shown() -> str:
        layout = MagicMock()
        panels._progress(layout, blender.context.window_manager.roigs)
        return str(layout.mock_calls)

    assert "Esc" not in shown()
    runner.hears_esc = True
    assert "Esc" in shown()
    runner.stop()
    assert "Esc" not in shown()
    jobs.wait(runner)


@pytest.mark.blender
def test_a_python_that_does_not_start(blender: ModuleType, work, tmp_path: Path) -> None:
    from roigs_addon import jobs
    from roigs_addon.errors import AddonError

    with pytest.raises(AddonError, match="cannot be started"):
        jobs.start(Engine(python=tmp_path / "nowhere", source=tmp_path), work())
    assert not jobs.busy()


# --- deaths, with the real engine ---


def checkpoints(folder: Path) -> list[Path]:
    return list(folder.glob("*/checkpoint.bin"))


def training(state) -> bool:
    return state.stage in ("scene", "joint") and state.step > 5


@pytest.fixture
def long_run(blender: ModuleType, engine, project: Path, tmp_path: Path):
    """A training that goes on for a minute at least, with the operator's own work: its runner."""
    from roigs_addon import jobs
    from roigs_addon.operators.train import TrainRoi
    from tests.addon.scenes import ready

    class Asker:
        active_only = selected_only = go_on = False
        _rois = TrainRoi._rois

    scene = ready(blender, project, tmp_path / "run", factor=10.0)
    runner = jobs.start(engine, TrainRoi.work(Asker(), blender.context))
    state = blender.context.window_manager.roigs
    assert until(lambda: not runner.poll() or training(state), 60), state.error
    assert runner.poll(), state.error
    yield scene, runner
    if jobs.busy():
        runner.job.kill()
        runner.job.wait()


@pytest.mark.blender
def test_stop_answers_within_two_seconds(blender: ModuleType, long_run, tmp_path: Path) -> None:
    from roigs_addon import jobs
    from roigs_addon.operators import train

    scene, runner = long_run
    state = blender.context.window_manager.roigs
    start = time.monotonic()
    assert blender.ops.roigs.stop() == {"FINISHED"}
    assert until(lambda: not runner.poll(), 30)
    assert time.monotonic() - start < 2
    assert runner.outcome.stopped and not runner.outcome.failed
    assert state.error == "" and state.message.startswith("Stopped")
    assert checkpoints(tmp_path / "run") and train.unfinished(scene)
    assert not (tmp_path / "run" / "result.ply").exists() and not jobs.busy()
    assert not blender.ops.roigs.stop.poll()


@pytest.mark.blender
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_killed_engine_is_an_error(blender: ModuleType, long_run) -> None:
    from roigs_addon import jobs

    _, runner = long_run
    os.kill(runner.job.pid, signal.SIGKILL)
    assert until(lambda: not runner.poll(), 10)
    state = blender.context.window_manager.roigs
    assert "signal 9" in state.error and "\n" not in state.error
    assert runner.outcome.failed and not jobs.busy()


BLENDER_SCRIPT = """
import sys, json
sys.path.insert(0, {root!r})
import bpy, roigs_addon
bpy.ops.wm.read_factory_settings(use_empty=True)
roigs_addon.register()
from pathlib import Path
from tests.addon.scenes import ready
from roigs_addon import jobs
start = jobs.start
def noted(engine, work):
    runner = start(engine, work)
    print("PID", work.title, runner.job.pid, flush=True)
    return runner
jobs.start = noted
ready(bpy, Path({project!r}), Path({run!r}), factor={factor})
print("TRAIN", bpy.ops.roigs.train_roi(), flush=True)
roigs_addon.unregister()
"""


def blender_process(folder: Path, project: Path, factor: float) -> subprocess.Popen[str]:
    """Another Blender like this one that trains in folder/run."""
    import bpy

    script = folder / "train.py"
    values = {"root": str(ROOT), "project": str(project), "run": str(folder / "run")}
    script.write_text(BLENDER_SCRIPT.format(**values, factor=factor), encoding="utf-8")
    command = [sys.executable, str(script)]
    program = bpy.app.binary_path and (os.environ.get("ROIGS_BLENDER") or bpy.app.binary_path)
    if program:
        command = [program, "-b", "--factory-startup", "--python", str(script)]
    environment = {**os.environ, VARIABLE: os.environ.get(VARIABLE) or sys.executable}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    )


def engine_pid(process: subprocess.Popen[str], title: str) -> int:
    """The engine that the other Blender started for a job of this title."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"PID {title}"):
            return int(line.split()[-1])
    raise AssertionError("the other Blender did not start the engine")


@pytest.mark.blender
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_no_engine_outlives_a_killed_blender(engine, project: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with blender_process(tmp_path, project, 10.0) as process:
        pid = engine_pid(process, "Training")
        events = run / "events.jsonl"
        assert until(lambda: events.is_file() and '"progress"' in events.read_text(), 60)
        assert alive(pid)
        process.kill()
    assert until(lambda: not alive(pid), 5)
    assert checkpoints(run)
    job = Job(engine, ["train", str(run / "blender" / "train.json"), "--run-dir", str(run)])
    said = []
    assert until(lambda: said.extend(job.events()) or any("goes on" in str(e) for e in said), 60)
    job.stop()
    assert job.wait(5) and job.outcome().stopped
