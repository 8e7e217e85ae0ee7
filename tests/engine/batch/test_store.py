"""`batch` with scenes and run folders on a store: the same bytes, nothing half published."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.batch import staged
from roigs_engine.batch.engine_process import FAILED, LOST, STOPPED, Outcome
from roigs_engine.batch.parts import Part, Staging
from roigs_engine.batch.staged import stored_run
from roigs_engine.cli import main
from roigs_engine.storage.quota import enforce_quota, keep
from roigs_engine.storage.urls import folder_of
from tests.engine.batches import contents, table_of
from tests.engine.commands.command_line import refused
from tests.engine.commands.forked_engines import forked_engines
from tests.engine.synthetic_colmap import write_project

__all__ = ["forked_engines"]
RUNS = "memory://museum/runs"
STAGING = Staging(url=RUNS, base="x", options={})
PART = Part(scene="hall", name="scene", argv=("run",), staging=STAGING)


@pytest.fixture
def table(memory_store: Any, tmp_path: Path) -> Path:
    """A table whose scenes are on the store."""
    names = [f"{k}.png" for k in range(10)]
    for name in ("hall", "attic"):
        write_project(tmp_path / "scans" / name, names=names, dots=True)
        memory_store.put(str(tmp_path / "scans" / name), f"/museum/scans/{name}", recursive=True)
    path = table_of(tmp_path, tmp_path / "scans")
    text = path.read_text(encoding="utf-8")
    for name in ("hall", "attic"):
        text = text.replace(f"'{tmp_path / 'scans' / name}'", f"'memory://museum/scans/{name}'")
    path.write_text(text, encoding="utf-8")
    return path


def test_the_same_bytes_and_a_machine_that_is_lost(
    table: Path,
    memory_store: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    forked_engines: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    real, lost = staged._leased, []

    def lose(argv: Any, part: Part, staging: Any, run: Any, *rest: Any) -> Outcome:
        """The machine of the first stage is lost while it publishes; another one goes on."""
        if part.name == "scene" and not lost:
            lost.append(staging)
            run._put = lambda *_: (_ for _ in ()).throw(KeyError("the machine is gone"))
            assert real(argv, part, staging, run, *rest)
        return real(argv, part, staging, run, *rest)

    def elsewhere(part: Part, *rest: Any) -> Outcome:
        """Each part on a machine of its own."""
        monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "homes" / part.scene / part.name))
        try:
            return one(part, *rest)
        except Exception as error:
            return Outcome(state=LOST, reason=str(error))

    one = staged.run_part
    monkeypatch.setattr(staged, "_leased", lose)
    monkeypatch.setattr("roigs_engine.batch.local.run_part", elsewhere)
    assert main(["batch", str(table), "--run-dir", RUNS, "--jobs", "1"]) == 0
    assert not list((tmp_path / "homes").rglob("outputs/*.ply"))  # they are on the store
    monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "home"))
    assert not [path for path in memory_store.find("/museum/runs") if ".lease" in path]
    names = ("hall", "attic")
    for name in names:
        memory_store.get(f"/museum/runs/{name}", str(tmp_path / "got" / name), recursive=True)
        got = {k: v for k, v in contents(tmp_path / "got" / name).items() if k[0] != "."}
        row = tmp_path / f"{name}-row.json"
        record = json.loads((tmp_path / "home").rglob(f"rows/{name}.json").__next__().read_text())
        row.write_text(json.dumps(record), encoding="utf-8")
        assert main(["run", str(row), "--run-dir", str(tmp_path / "hand" / name)]) == 0
        assert got == contents(tmp_path / "hand" / name)
    page = memory_store.cat("/museum/runs/report.html").decode()
    assert "3 of 3 objects done" in page and page.count('href="hall/rois/') == 2
    capsys.readouterr()
    assert main(["batch", str(table), "--run-dir", RUNS, "--dry-run"]) == 0
    assert capsys.readouterr().out.count(" done\n") == 2
    memory_store.rm("/museum/runs/outputs/hall.compressed.ply")
    assert main(["batch", str(table), "--run-dir", RUNS, "--jobs", "1"]) == 0
    assert memory_store.exists("/museum/runs/outputs/hall.compressed.ply")
    assert "attic: done" not in capsys.readouterr().err
    # A result that somebody deletes or changes there is made again, and its outputs can be.
    results = {name: memory_store.cat(f"/museum/runs/{name}/result.ply") for name in names}
    memory_store.rm("/museum/runs/hall/result.ply")
    memory_store.pipe("/museum/runs/attic/result.ply", bytes(len(results["attic"])))
    monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "empty"))
    assert main(["batch", str(table), "--run-dir", RUNS, "--jobs", "1"]) == 0
    for name, result in results.items():
        assert memory_store.cat(f"/museum/runs/{name}/result.ply") == result


def test_a_full_disk_of_one_machine_is_its_reason(
    table: Path, memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Any, *_: Any) -> None:
        raise OSError(28, "No space left on device")

    staging = Staging(url=RUNS, base="x", options={"scene": "memory://museum/scans/hall"})
    part = replace(PART, staging=staging)
    monkeypatch.setattr(type(memory_store), "get_file", full)
    ended = staged.run_part(part, 1, lambda event: None, lambda: False)
    assert ended.state == FAILED and "No space left on device" in ended.reason
    assert not list(memory_store.find("/museum/runs"))  # nothing of it is published or held


def test_a_part_makes_room_of_what_was_used_long_ago(
    memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not its own run folder, however long it takes, nor one that is at work beside it."""
    old = time.time() - 7200
    runs = folder_of(RUNS, staged.RUNS)
    for name in ("hall", "attic", "cellar"):
        (runs / name).mkdir(parents=True)
        (runs / name / "result.ply").write_bytes(bytes(5000))
        os.utime(runs / name, (old, old))
    memory_store.pipe("/museum/runs/hall/rois/vase.ply", b"")
    monkeypatch.setenv("ROIGS_CACHE_GB", "0")
    monkeypatch.setattr(staged, "PUBLISH_SECONDS", 0.01)

    def engine(*_: Any) -> Outcome:
        keep(runs / "attic")
        os.utime(runs / "hall", (old, old))
        until = time.monotonic() + 20
        while (runs / "hall").stat().st_mtime < old + 1 and time.monotonic() < until:
            time.sleep(0.01)
        enforce_quota()
        assert (runs / "hall").is_dir() and not (runs / "cellar").exists()
        return Outcome(state=STOPPED)

    monkeypatch.setattr(staged, "run_engine", engine)
    assert staged.run_part(PART, 1, lambda event: None, lambda: False).state == STOPPED
    assert (runs / "hall").is_dir() and (runs / "attic").is_dir()


def test_a_checkpoint_is_published_with_what_it_needs(
    memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else, after this engine is lost, no other one can resume: no manifest, no run folder."""
    folder = folder_of(RUNS, staged.RUNS) / "hall"
    names = {"manifest.json", "selection/vase.json", "stages/scene-1/checkpoint.bin"}
    monkeypatch.setattr(staged, "PUBLISH_SECONDS", 0.01)

    def engine(*_: Any) -> Outcome:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(b"1")
        (folder / ".result.ply.1-00000000.part").write_bytes(b"half")
        until = time.monotonic() + 20
        while stored_run(RUNS, "hall").entries().keys() != names and time.monotonic() < until:
            (folder / "stages" / "scene-1" / "checkpoint.bin").write_bytes(b"2")
            time.sleep(0.01)
        return Outcome(state=LOST)

    monkeypatch.setattr(staged, "run_engine", engine)
    assert staged.run_part(PART, 1, lambda event: None, lambda: False).state == LOST
    assert stored_run(RUNS, "hall").entries().keys() == names


def test_any_error_of_a_part_is_an_outcome(
    memory_store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without one, the batch would wait for the part for ever."""

    def broken(*_: Any) -> None:
        raise RuntimeError("An error occurred (AccessDenied)\nmore")

    monkeypatch.setattr(staged, "stored_run", broken)
    ended = staged.run_part(PART, 1, lambda event: None, lambda: False)
    assert (ended.state, ended.reason) == (LOST, "An error occurred (AccessDenied)")


def test_half_a_commit_is_none(memory_store: Any, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    (folder / "scene").mkdir(parents=True)
    model = folder / "scene" / "model.ply"
    model.write_bytes(b"first")
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    model.write_bytes(b"second")
    run = stored_run(RUNS, "hall")
    run.publish(folder, "joint", last=False)
    whole = memory_store.cat("/museum/runs/hall/.commits/joint.json")
    memory_store.pipe(
        "/museum/runs/hall/.commits/joint.json", whole[:-9]
    )  # killed while it was written
    stored_run(RUNS, "hall").fetch(tmp_path / "got")
    assert (tmp_path / "got" / "scene" / "model.ply").read_bytes() == b"first"
    memory_store.pipe("/museum/runs/hall/.commits/joint.json", whole)
    run.fetch(tmp_path / "got")
    assert (tmp_path / "got" / "scene" / "model.ply").read_bytes() == b"second"
    model.unlink()
    run.publish(folder, "archive", last=True)  # what is gone stays gone
    run.fetch(tmp_path / "got")
    assert not (tmp_path / "got" / "scene" / "model.ply").exists()
    assert not memory_store.exists("/museum/runs/hall/.objects") or not memory_store.find(
        "/museum/runs/hall/.objects"
    )


def test_addresses_that_cannot_be_used_are_one_line(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "nosuch" in refused(capsys, "batch", table, "--run-dir", "nosuch://bucket/runs")
    text = table.read_text(encoding="utf-8").replace("scans/hall", "scans/nothing")
    table.write_text(text, encoding="utf-8")
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "Scene 'hall': There is nothing at memory://museum/scans/nothing." in said
    chained = "simplecache::s3://bucket/runs"
    for other in ("dask://host:8786/runs", "s3://a/b::dask://host:8786", chained):
        assert "is not an address of a store" in refused(capsys, "batch", table, "--run-dir", other)
    for secret in (
        *("https://host/x?sig=hidden", "https://hidden@host:9/x", "sftp://me:hid/hidden@host/x"),
        *("az://store@account/x?sig=hidden", "file:///runs?token=hidden", "::s3://me:hidden@x"),
        "ftp://me:hidden@host/runs",
    ):
        line = refused(capsys, "batch", table, "--run-dir", secret)
        assert "it has a password" in line and "hidden" not in line
    almost = ("s3:me:hidden@bucket", "data:text,hidden", "::s3:hidden")
    for url in almost:
        line = refused(capsys, "batch", table, "--run-dir", url)
        assert "it looks like an address" in line and "hidden" not in line
    for url, expected in ((secret, "it has a password"), *((u, "looks like an") for u in almost)):
        table.write_text(f"[scenes.hall]\nscene = '{url}'\nroi = ['auto']\n", encoding="utf-8")
        assert main(["batch", str(table), "--run-dir", str(tmp_path / "run")]) == 2
        said = capsys.readouterr().err
        assert expected in said and "hidden" not in said
    table.write_text(f"[scenes.hall]\nmade_for = '{secret}'\nseed = '{secret}'\n", encoding="utf-8")
    assert main(["batch", str(table), "--run-dir", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "ftp://...@host/runs" in said and "hidden" not in said
    with monkeypatch.context() as endpoint:
        endpoint.setenv("AWS_ENDPOINT_URL", "http://me:hidden@host:9000")
        line = refused(capsys, "batch", table, "--run-dir", "s3://bucket/runs")
        assert "AWS_ENDPOINT_URL has a password" in line and "hidden" not in line
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    line = refused(capsys, "batch", table, "--run-dir", "s3://bucket/runs")
    assert "s3://bucket/runs needs fsspec, which is not installed" in line


@pytest.mark.parametrize(
    "name", ["report.html", "batch.json", "outputs/hall.glb", "hall/report.md"]
)
def test_files_of_others_on_a_store_are_not_replaced(
    table: Path, memory_store: Any, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    memory_store.pipe(f"/museum/runs/{name}", b"theirs")
    line = refused(capsys, "batch", table, "--run-dir", RUNS)
    assert f"is not the folder of a batch, which would replace {RUNS}/{name}" in line
    assert memory_store.cat(f"/museum/runs/{name}") == b"theirs"


def test_what_an_address_needs_is_named(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "s3fs", None)
    monkeypatch.setitem(__import__("sys").modules, "aiohttp", None)
    for url, package in (("s3a://bucket/runs", "s3fs"), ("http://host/runs", "aiohttp")):
        assert f"{url} needs {package}," in refused(capsys, "batch", table, "--run-dir", url)
