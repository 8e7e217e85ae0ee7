"""Progress of a batch: on a terminal, as lines, as events; its page."""

from __future__ import annotations

import io
import json
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

from roigs_engine.batch.board import Reporter
from roigs_engine.batch.engine_process import DONE, Outcome
from roigs_engine.batch.page import write_batch_page
from roigs_engine.batch.record import BatchRecord
from roigs_engine.batch.schedule import RUNNING, Scheduler
from roigs_engine.commands.console import Console
from roigs_engine.context import QUIET
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.events import parse_event
from roigs_engine.formats.text import duration
from tests.engine.batch.parts_of_scenes import Instant, part, scene

STEP = parse_event(
    '{"event": "progress", "stage": "joint", "step": 50, "total": 100, "loss": 0.1, "psnr": 21.5,'
    ' "gaussians": 9, "seconds_left": 3}'
)
WARNING = parse_event('{"event": "message", "text": "Dark photos.", "level": "warning"}')


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def scheduler() -> Scheduler:
    """One scene is done, the other half done."""
    scenes = [
        scene("attic", part("attic", "all", work=10)),
        scene("hall", part("hall", "all", work=10)),
    ]
    made = Scheduler(scenes, Instant(), QUIET, retries=0, told=lambda *_: None)
    state = made.scenes["hall"].parts["all"]
    state.state, state.progress = RUNNING, STEP or {}
    return made


def reporter(scheduler: Scheduler, *, json_lines: bool = False) -> Reporter:
    """A console's reporter of a batch of 15 s: one scene was done, and half of the other."""
    found = Reporter(scheduler.scenes, Console(json_lines=json_lines).context)
    scheduler.scenes["attic"].parts["all"].state = DONE
    found._started, found._before = time.monotonic() - 15, 0.0
    return found


def test_objects_step_psnr_and_time_left(scheduler: Scheduler) -> None:
    lines = reporter(scheduler).lines()
    assert lines[0] == "1 of 2 objects done, 1 running, about 5 seconds left"
    assert lines[1] == "  hall  joint  step 50 of 100  21.50 dB"
    scheduler.scenes["hall"].parts["all"].state = DONE
    assert reporter(scheduler).head() == "2 of 2 objects done, 0 running"
    assert [duration(s) for s in (1, 120, 7200, 1e6)] == [
        *("1 second", "2 minutes", "2.0 hours", "11.6 days")
    ]


def test_a_terminal_has_one_board_that_changes(
    scheduler: Scheduler, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    shown = reporter(scheduler, json_lines=False)
    hall = scheduler.scenes["hall"]
    shown._draw(now=True)
    for _ in range(2):  # said once
        shown.take(hall, hall.parts["all"], WARNING or {})
    shown._draw(now=True)
    text = terminal.getvalue()
    assert text.count("\x1b[2A\x1b[J") == 1  # two lines were drawn, and then again
    assert text.count("warning: hall: Dark photos.") == 1
    assert text.count("step 50 of 100") == 2


def test_lines_where_no_terminal_is(
    scheduler: Scheduler, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = reporter(scheduler, json_lines=False)
    attic, hall = scheduler.scenes["attic"], scheduler.scenes["hall"]
    shown.take(hall, hall.parts["all"], STEP or {})
    shown.take(attic, attic.parts["all"], Outcome(state=DONE))
    assert capsys.readouterr().err.startswith("attic: done in 1 second. 1 of 2 objects done")


def test_events_for_programs(scheduler: Scheduler, capsys: pytest.CaptureFixture[str]) -> None:
    shown = reporter(scheduler, json_lines=True)
    attic, hall = scheduler.scenes["attic"], scheduler.scenes["hall"]
    shown.take(hall, hall.parts["all"], STEP or {})
    shown.take(attic, attic.parts["all"], Outcome(state=DONE))
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["stage"], first["step"], first["psnr"]) == ("hall: joint", 50, 21.5)
    assert (second["stage"], second["step"], second["total"]) == ("batch", 1, 2)


def test_the_page_is_safe_text(scheduler: Scheduler, tmp_path: Path) -> None:
    run = tmp_path / "attic"
    crops = run / "crops" / "attic-box"
    crops.mkdir(parents=True)
    Image.new("RGB", (800, 600)).save(crops / "overview.png")
    row = {"roi_psnr": 30.25, "roi_ssim": None, "gaussians_in_box": 1234, "seconds": 90}
    report = {"rois": [{"roi": "attic-box", "rows": [{}, row]}]}
    (run / "report.json").write_text(json.dumps(report), encoding="utf-8")
    (run / "report.html").touch()
    reporter(scheduler)
    scheduler.scenes["hall"].reason = "<script>alert(1)</script>"
    page = write_batch_page(tmp_path, scheduler.scenes.values()).read_text(encoding="utf-8")
    assert "30.25" in page and "1,234" in page and 'href="attic/report.html"' in page
    assert page.count("data:image/jpeg") == 1
    assert "<script" not in page and "failed: &lt;script&gt;" in page
    assert "1 of 2 objects done, 1 failed" in page
    assert page.index("<td>hall-box") < page.index("<td>attic-box")  # failures on top


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 1}', '{"version": 9, "scenes": {}}'])
def test_a_record_that_is_damaged_counts_as_empty(tmp_path: Path, text: str) -> None:
    (tmp_path / "batch.json").write_text(text, encoding="utf-8")
    assert BatchRecord(tmp_path)._scenes == {}


def test_a_result_that_a_network_drive_shows_late_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    (tmp_path / "hall" / "manifest.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"Cannot read .*result\.ply"):
        BatchRecord(tmp_path).add("hall", "row", tmp_path / "hall", [])
