"""Commits on a store that somebody else can write to: what they name stays in the run folder."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.batch.staged import stored_run
from roigs_engine.errors import RunFolderError
from roigs_engine.formats import names
from roigs_engine.formats.names import inner_path
from roigs_engine.formats.text import json_digest
from roigs_engine.storage import urls
from roigs_engine.storage.commits import KEY, VERSION
from roigs_engine.storage.lease import Lease
from roigs_engine.storage.urls import StoreError, file_system
from tests.engine.commands.command_line import refused

RUNS = "memory://museum/runs"
COMMIT = "/museum/runs/hall/.commits/scene.json"
OUTSIDE = [
    "../x",
    "/tmp/x",
    "a/../../x",
    "C:/x",
    "C:x",
    "..\\x",
    "\\\\host\\x",
    "\\x",
    "",
    ".",
    "a\0b",
    "a\ud800",
    5,
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "run" / "selection").mkdir(parents=True)
    (tmp_path / "run" / "selection" / "vase.json").write_bytes(b"picks")
    return tmp_path / "run"


def forge(store: Any, **changes: Any) -> None:
    """Change the commit as somebody who knows the format can."""
    body = json.loads(store.cat(COMMIT)) | changes
    body = {key: value for key, value in body.items() if value is not ...}
    del body["digest"]
    digest = json_digest(body | {"run": "hall"})
    store.pipe(COMMIT, json.dumps(body | {"digest": digest}).encode())


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_that_lead_out(name: Any) -> None:
    assert inner_path(name) is None


@pytest.mark.parametrize("name", ["nul", "a/aux.txt", "COM1.ply"])
def test_windows_opens_no_devices(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for windows in (False, True):
        monkeypatch.setattr(names, "WINDOWS", windows)
        assert (inner_path(name) is None) == windows


@pytest.mark.parametrize("name", ["a", "rois/vase.ply", "12:30.jpg", "a..b/c", "ä é/漢.png"])
def test_names_that_stay_inside(name: str) -> None:
    assert str(inner_path(name)) == name


@pytest.mark.parametrize("name", [name for name in OUTSIDE if isinstance(name, str)])
def test_a_commit_writes_nothing_outside(
    name: str, folder: Path, memory_store: Any, tmp_path: Path
) -> None:
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    entry = json.loads(memory_store.cat(COMMIT))["files"]["selection/vase.json"]
    absolute = str(tmp_path / "stolen") if name.startswith("/") else name
    for changes in ({"files": {absolute: entry}}, {"gone": [absolute]}):
        forge(memory_store, **changes)
        with pytest.raises(RunFolderError, match="not a commit of the engine"):
            stored_run(RUNS, "hall").fetch(tmp_path / "got")
    forge(memory_store, files={"a": entry | {"at": absolute}}, gone=[])
    with pytest.raises(RunFolderError, match="not a commit of the engine"):
        stored_run(RUNS, "hall").fetch(tmp_path / "got")
    assert not (tmp_path / "stolen").exists() and not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "changes",
    [
        *({"gone": ...}, {"files": None}, {"files": {"a": None}}, {"serial": "1"}, {"part": None}),
        *({"files": {"a": {"sha": 1, "size": 1, "at": "a"}}}, {"gone": {"a": 1}}, {"serial": ...}),
        {"files": {key: {"sha": "1", "size": 1, "at": "a"} for key in ("a", "a/b")}},
    ],
    ids=str,
)
def test_a_commit_of_another_form_is_one_line(
    changes: dict[str, Any], folder: Path, memory_store: Any
) -> None:
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    forge(memory_store, **changes)
    with pytest.raises(RunFolderError, match="not a commit of the engine"):
        stored_run(RUNS, "hall").entries()


def test_a_link_in_the_copy_is_not_followed(
    folder: Path, memory_store: Any, tmp_path: Path
) -> None:
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "got").mkdir()
    (tmp_path / "got" / "selection").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunFolderError):
        stored_run(RUNS, "hall").fetch(tmp_path / "got")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_commits_are_of_their_run_and_signed(
    folder: Path, memory_store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    memory_store.pipe(COMMIT.replace("hall", "attic"), memory_store.cat(COMMIT))
    assert stored_run(RUNS, "hall").entries() and not stored_run(RUNS, "attic").entries()
    monkeypatch.setenv(KEY, "secret")
    assert not stored_run(RUNS, "hall").entries()  # it is not signed
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    assert stored_run(RUNS, "hall").entries()
    forge(memory_store, version=VERSION)
    assert not stored_run(RUNS, "hall").entries()


def test_what_a_lost_engine_left_is_gone(folder: Path, memory_store: Any, tmp_path: Path) -> None:
    """An empty folder is refused as somebody else's by the next run."""
    stored_run(RUNS, "hall").fetch(folder)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("data", [b"[" * 200_000, b'{"a":' * 100_000, b"1" * 5000, b"\xff", b"[]"])
def test_a_commit_that_is_none_does_not_count(
    data: bytes, folder: Path, memory_store: Any, tmp_path: Path
) -> None:
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    memory_store.pipe(COMMIT.replace("scene", "other"), data)
    memory_store.pipe(COMMIT.rpartition("/.commits")[0] + "/.leases/scene/0", data)
    stored_run(RUNS, "hall").fetch(tmp_path / "got")
    assert (tmp_path / "got" / "selection" / "vase.json").read_bytes() == b"picks"


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), RuntimeError("SlowDown\nx")])
def test_a_commit_that_cannot_be_read_now_is_not_a_missing_one(
    error: Exception,
    folder: Path,
    memory_store: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """Else its files would go here, and the work be done again; a batch says it in one line."""
    run = stored_run(RUNS, "hall")
    run.publish(folder, "scene", last=False)
    run.fetch(tmp_path / "got")

    def away(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(type(memory_store), "cat_file", away)
    with pytest.raises(StoreError, match="Cannot use memory://museum/runs"):
        run.fetch(tmp_path / "got")
    assert (tmp_path / "got" / "selection" / "vase.json").exists()
    table = tmp_path / "museum.toml"
    table.write_text("[scenes.hall]\nscene = 'hall'\nroi = ['a=0,0,0,1,1,1']\n", encoding="utf-8")
    (tmp_path / "hall" / "sparse").mkdir(parents=True)
    assert "Cannot use memory://" in refused(capsys, "batch", table, "--run-dir", RUNS)


def test_records_that_are_too_large_are_not_read(
    memory_store: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Anyone who can write to a store could fill the memory of all machines."""
    stored_run(RUNS, "hall").publish(folder, "scene", last=False)
    memory_store.pipe("/museum/runs/hall/.commits/huge.json", bytes(5000))
    memory_store.pipe(f"/museum/runs/hall/.leases/scene/{'a' * 32}", bytes(5000))
    read = []
    real = type(memory_store).cat_file

    def cat_file(self: Any, path: str, *rest: Any, **more: Any) -> bytes:
        read.append(path)
        return bytes(real(self, path, *rest, **more))

    monkeypatch.setattr(type(memory_store), "cat_file", cat_file)
    monkeypatch.setattr(urls, "LARGEST", 4000)
    run = stored_run(RUNS, "hall")
    assert run.entries().keys() == {"selection/vase.json"}
    found, _ = file_system(RUNS)
    with Lease(found, run.lease_folder("scene")):
        pass
    assert not [path for path in read if "huge" in path or "a" * 32 in path]


def test_a_key_of_any_bytes(
    memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEY, os.fsdecode(b"\xff\xfe"))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.ply").write_bytes(b"made")
    run = stored_run(RUNS, "hall")
    run.publish(tmp_path / "run", "all", last=True)
    assert list(run.entries()) == ["result.ply"]
    monkeypatch.setenv(KEY, "another")
    assert not run.entries()
