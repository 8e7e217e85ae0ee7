"""The engine that draws frames: answers, refusals, and an engine that hangs; without Blender."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from roigs_addon.engine import frame_engine
from roigs_addon.engine.frame_engine import FrameEngine
from tests.addon.fake_engine import alive, fake, until

HEAD = """
from pathlib import Path
folder = Path(sys.argv[2])
def request():
    while not (found := list(folder.glob("*.json"))):
        time.sleep(0.01)
    return found[0]
"""


@contextmanager
def drawing(tmp_path: Path, code: str) -> Iterator[FrameEngine]:
    requests = tmp_path / "requests"
    requests.mkdir()
    engine = FrameEngine(fake(tmp_path, HEAD + code), requests, [])
    try:
        yield engine
    finally:
        engine.close()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> float:
    """Silence that is long enough to give up, in seconds."""
    monkeypatch.setattr(frame_engine, "SILENT_SECONDS", 1.5)
    monkeypatch.setattr(frame_engine, "END_SECONDS", 0.5)
    return 1.5


def test_frames_are_drawn_or_refused(tmp_path: Path) -> None:
    code = """
for n in range(4):
    path = request()
    if n % 2:
        say(event="message", text="It is malformed.", level="warning")
    else:
        say(event="preview", path="a.png")
    time.sleep(0.1)
    path.unlink()
sys.exit(1)
"""
    with drawing(tmp_path, code) as engine:
        assert [engine.draw({}) for _ in range(4)] == ["", "It is malformed."] * 2
        assert until(lambda: not engine.alive())
        assert "status 1" in engine.draw({})


def test_a_frame_of_an_engine_that_hangs_is_given_up(tmp_path: Path, impatient: float) -> None:
    """It is ended, so that the next frame gets another one."""
    code = f"""
Path({str(tmp_path / "pid")!r}).write_text(str(os.getpid()))
request()
say(event="message", text="Begun")
time.sleep(600)
"""
    with drawing(tmp_path, code) as engine:
        began = time.monotonic()
        problem = engine.draw({})
        assert "did not respond" in problem and "\n" not in problem
        assert time.monotonic() - began < impatient + 10
        assert not engine.alive() and not list((tmp_path / "requests").iterdir())
    assert not alive(int((tmp_path / "pid").read_text()))


def test_a_slow_engine_is_waited_for(tmp_path: Path, impatient: float) -> None:
    """As long as it says something now and then."""
    code = """
path = request()
for step in range(8):
    time.sleep(0.5)
    say(event="progress", stage="models", step=step, total=8)
say(event="preview", path="a.png")
path.unlink()
sys.stdin.read()
"""
    with drawing(tmp_path, code) as engine:
        assert engine.draw({}) == "" and engine.alive()


def test_the_sleep_of_a_computer_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(frame_engine.time, "monotonic", lambda: clock[0])
    silence = frame_engine._Silence()
    clock[0] = 0.5
    assert silence.seconds() == 0.5
    clock[0] = 30_000.0
    assert silence.seconds() <= 0.5 + frame_engine.LONGEST_PAUSE
