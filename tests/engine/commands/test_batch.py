"""`batch`: whole tables, here, several parts at a time."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from roigs_engine.formats.splat_ply import read_ply
from tests.engine.batch.clusters import engines
from tests.engine.batches import contents, table_of
from tests.engine.commands.command_line import python, refused, start
from tests.engine.commands.forked_engines import forked_engines
from tests.engine.runs import stage_of
from tests.engine.synthetic_colmap import write_project

NAMES = [f"{k}.png" for k in range(10)]
__all__ = ["forked_engines"]


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("museum")
    for name in ("hall", "attic"):
        write_project(folder / name, names=NAMES, dots=True)
    return folder


@pytest.fixture(scope="module")
def finished(scans: Path, tmp_path_factory: pytest.TempPathFactory, forked_engines: None) -> Path:
    """The folder of a table and of its batch, `run`, done by two engines at a time."""
    folder = tmp_path_factory.mktemp("batch")
    table = table_of(folder, scans)
    assert main(["batch", str(table), "--run-dir", str(folder / "run"), "--jobs", "2"]) == 0
    return folder


def test_the_same_bytes_as_runs_by_hand(finished: Path, tmp_path: Path) -> None:
    for name in ("hall", "attic"):
        options = finished / "run" / run_files.BATCH_ROWS / f"{name}.json"
        assert main(["run", str(options), "--run-dir", str(tmp_path / name)]) == 0
        assert contents(finished / "run" / name) == contents(tmp_path / name)
    made = finished / "run" / run_files.BATCH_OUTPUTS
    found = sorted(p.relative_to(made).as_posix() for p in made.rglob("*.ply"))
    assert found == ["attic.compressed.ply", "hall.compressed.ply"]


def test_one_page_over_all_objects(finished: Path) -> None:
    page = (finished / "run" / run_files.REPORT_PAGE).read_text(encoding="utf-8")
    assert "3 of 3 objects done" in page
    assert page.count("data:image/jpeg") == 3
    assert 'href="hall/rois/vase.ply"' in page and 'href="attic/report.html"' in page


def test_done_objects_are_not_done_again(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p: p.stat().st_mtime_ns for p in (finished / "run").rglob("*.ply")}
    table = str(finished / "museum.toml")
    assert main(["batch", table, "--run-dir", str(finished / "run"), "--dry-run"]) == 0
    assert capsys.readouterr().out.count(" done\n") == 2
    assert main(["batch", table, "--run-dir", str(finished / "run")]) == 0
    assert {p: p.stat().st_mtime_ns for p in (finished / "run").rglob("*.ply")} == before


def test_a_run_folder_is_not_the_folder_of_a_batch(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = finished / "run" / "attic"
    line = refused(capsys, "batch", finished / "museum.toml", "--run-dir", place)
    assert "is the folder of one run" in line and not (place / "attic").exists()


def times(folder: Path) -> dict[str, int]:
    return {p.relative_to(folder).as_posix(): p.stat().st_mtime_ns for p in folder.rglob("*.ply")}


def test_outputs_alone_are_made_again(
    finished: Path, scans: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the table wants others, their settings change, or somebody deletes one."""
    run, table = finished / "run", finished / "museum.toml"
    text, before = table.read_text(encoding="utf-8"), times(run)
    more = text.replace("[scenes.attic]", "[scenes.attic]\nfrom_up = 'z'\noutputs = ['ply']")
    table.write_text(more.replace("[scenes.hall]", "[scenes.hall]\nobject_outputs = ['ply']"))
    (run / "outputs" / "hall.compressed.ply").unlink()
    assert main(["batch", str(table), "--run-dir", str(run), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert shown.count(" outputs\n") == 2 and "4 parts" in shown and " done\n" not in shown
    assert main(["batch", str(table), "--run-dir", str(run)]) == 0
    after = times(run)
    made = {"outputs/attic.ply", "outputs/hall/vase.ply", "outputs/hall/lamp.ply"}
    assert {k for k, v in after.items() if before.get(k) != v} == {
        *made,
        "outputs/hall.compressed.ply",
    }
    means = [read_ply(run / name)["means"] for name in ("attic/result.ply", "outputs/attic.ply")]
    np.testing.assert_allclose(means[1], means[0][:, [0, 2, 1]] * [1, -1, 1], atol=1e-5)
    table.write_text(more.replace("from_up = 'z'", "sh_degree = 0"))
    assert main(["batch", str(table), "--run-dir", str(run)]) == 0
    changed = {k for k, v in times(run).items() if after.get(k) != v}
    assert changed == {"outputs/attic.ply"}
    table.write_text(text, encoding="utf-8")


def test_a_dry_run_writes_nothing(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = table_of(tmp_path, scans)
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run"), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "3 objects in 2 scenes" in shown and "an estimate" in shown
    assert not (tmp_path / "run").exists()
    assert main(["batch", str(table), "--run-dir", "x", "--dry-run", "--scene", "cellar"]) == 2


def test_a_stop_and_a_scene_that_fails(
    scans: Path, tmp_path: Path, forked_engines: None, capsys: pytest.CaptureFixture[str]
) -> None:
    table, run = table_of(tmp_path, scans), tmp_path / "run"
    (run / "attic").mkdir(parents=True)
    (run / "attic" / run_files.RESULT).write_bytes(b"somebody's")  # a run would replace it
    with start("batch", table, "--run-dir", run, "--jobs", "2", "--events") as engine:
        assert engine.stdout is not None and engine.stdin is not None
        for line in engine.stdout:
            event = json.loads(line)
            if event["event"] == "stagestarted" and event["stage"].startswith("hall: "):
                engine.send_signal(signal.SIGINT)
                break
        rest = [json.loads(line) for line in engine.stdout]
        assert engine.wait(60) == 3
    assert rest[-1] == {"event": "done", "outputs": {}, "stopped": True}
    assert main(["batch", str(table), "--run-dir", str(run)]) == 2
    out, err = capsys.readouterr()
    assert "1 scene of 2 failed" in err.splitlines()[-1]
    assert "attic: " in out and "is not a run folder" in out
    assert (run / "hall" / run_files.RESULT).exists()
    assert (run / "attic" / run_files.RESULT).read_bytes() == b"somebody's"
    page = (run / run_files.REPORT_PAGE).read_text(encoding="utf-8")
    assert "failed: attic: " in page and "2 of 3 objects done" in page


def interrupted_twice(table: Path, run: Path) -> int:
    """The status of a batch that gets a second interrupt while its engines stop."""
    with start("batch", table, "--run-dir", run, "--jobs", "2", "--events") as engine:
        assert engine.stdout is not None and engine.stderr is not None
        for line in engine.stdout:
            if json.loads(line)["event"] == "stagestarted":
                break
        engine.send_signal(signal.SIGINT)
        time.sleep(0.05)  # two signals of one moment are one
        began = time.monotonic()
        engine.send_signal(signal.SIGINT)
        status = engine.wait(60)
        assert time.monotonic() - began < 10
        assert "Traceback" not in engine.stderr.read()
    return int(status)


@pytest.mark.skipif(os.name != "posix", reason="sends signals")
def test_a_second_interrupt_ends_a_batch_and_its_engines_at_once(
    scans: Path, tmp_path: Path, forked_engines: None
) -> None:
    """As after a kill, which `batch/test_kills.py` resumes."""
    table = table_of(tmp_path, scans)
    long = table.read_text(encoding="utf-8").replace("steps-factor = 0.003", "steps-factor = 5")
    table.write_text(long, encoding="utf-8")
    # On a busy machine, the batch may have ended before the second one: then it is tried again.
    tried = (interrupted_twice(table, tmp_path / f"run-{number}") for number in range(5))
    assert next((status for status in tried if status != 3), 3) == 130
    run = tmp_path
    until = time.monotonic() + 60
    while engines(run) and time.monotonic() < until:
        time.sleep(0.1)
    assert not engines(run)


def test_a_changed_box_redoes_what_depends_on_it(
    finished: Path, scans: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Last: it changes the folder."""
    run = finished / "run"
    attic = (run / "attic" / run_files.RESULT).stat().st_mtime_ns
    lamp = stage_of(run / "hall", "object-lamp")
    table = table_of(finished, scans, high=0.6)
    assert main(["batch", str(table), "--run-dir", str(run)]) == 0
    assert (run / "attic" / run_files.RESULT).stat().st_mtime_ns == attic
    manifest = json.loads((run / "hall" / run_files.MANIFEST).read_text(encoding="utf-8"))
    assert len(manifest["rois"]) == 2
    assert (run / "hall" / run_files.EARLIER).is_dir()
    assert (lamp / run_files.MODEL).is_file()
    text = table.read_text(encoding="utf-8").replace("'independent'", "'independent'\n{}")
    table.write_text(text.format("object_outputs = ['compressed.ply', 'ply']"), encoding="utf-8")
    assert main(["batch", str(table), "--run-dir", str(run)]) == 0
    table.write_text(text.format("only = ['vase']"), encoding="utf-8")
    whole = (run / "outputs" / "hall.compressed.ply").stat().st_mtime_ns
    (run / "outputs" / "hall" / "lamp.ply").unlink()
    capsys.readouterr()
    assert main(["batch", str(table), "--run-dir", str(run)]) == 0
    assert (run / "outputs" / "hall.compressed.ply").stat().st_mtime_ns > whole
    said = capsys.readouterr().err
    assert "outputs/hall/lamp.compressed.ply belongs to an earlier result" in said
    assert "lamp.ply is" not in said


@pytest.mark.slow
def test_warnings_as_errors_do_not_end_a_batch(
    scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    line = ["batch", str(table_of(tmp_path, scans)), "--run-dir", str(tmp_path / "run")]
    done = python(*line, cold=True)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr and "Warning:" not in done.stderr
