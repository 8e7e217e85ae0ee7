"""Links, pipes and files of others on stores that are folders, and among the copies here."""

from __future__ import annotations

import os
from contextlib import nullcontext, suppress
from pathlib import Path

import pytest

from roigs_engine.batch.staged import stored_run
from roigs_engine.context import QUIET
from roigs_engine.errors import EngineError, RunFolderError
from roigs_engine.storage import commits, lease, quota
from roigs_engine.storage.lease import Lease
from roigs_engine.storage.urls import HOME, StoreError, file_system, folder_of
from tests.engine.commands.command_line import BOX, refused
from tests.engine.synthetic_colmap import write_project

pytestmark = pytest.mark.skipif(os.name != "posix", reason="makes links and pipes")
MINE = b"mine, and not the engine's"


@pytest.fixture
def store(tmp_path: Path) -> Path:
    pytest.importorskip("fsspec")
    (tmp_path / "store" / "hall").mkdir(parents=True)
    return tmp_path / "store"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder of the user's."""
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("0001.jpg", "a" * 32, "b" * 64, "scene.json"):
        (folder / name).write_bytes(MINE)
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder to publish."""
    (tmp_path / "run").mkdir()
    for name in ("manifest.json", "result.ply"):
        (tmp_path / "run" / name).write_bytes(b"made")
    return tmp_path / "run"


def untouched(folder: Path) -> bool:
    files = list(folder.iterdir())
    return len(files) == 4 and all(path.read_bytes() == MINE for path in files)


@pytest.mark.parametrize("name", [".objects", ".commits", "result.ply", "manifest.json"])
def test_nothing_on_a_store_is_written_or_deleted_through_a_link(
    store: Path, mine: Path, run: Path, name: str
) -> None:
    target = mine if name.startswith(".") else mine / "0001.jpg"
    (store / "hall" / name).symlink_to(target)
    stored = stored_run(f"file://{store}", "hall")
    with suppress(StoreError):
        stored.publish(run, "scene", last=False)
    with nullcontext() if name == ".objects" else pytest.raises(StoreError, match="is a link"):
        stored.publish(run, "all", last=True)
    assert untouched(mine)


def test_tidying_a_store_leaves_files_of_others(store: Path, run: Path) -> None:
    others = [store / "hall" / name for name in (".objects/a.jpg", ".objects/b/c", ".commits/d")]
    for path in others:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(MINE)
    stored = stored_run(f"file://{store}", "hall")
    stored.publish(run, "scene", last=False)
    stored.publish(run, "all", last=True)
    assert {path.read_bytes() for path in others} == {MINE}
    assert not list(store.glob("hall/.objects/" + "?" * 64))


def test_a_pipe_on_a_store_is_one_line(store: Path, run: Path, tmp_path: Path) -> None:
    stored = stored_run(f"file://{store}", "hall")
    stored.publish(run, "all", last=True)
    (store / "hall" / "result.ply").unlink()
    os.mkfifo(store / "hall" / "result.ply")
    with pytest.raises(StoreError, match="a pipe"):
        stored.fetch(tmp_path / "copy")


def test_a_lease_leaves_files_of_others(
    store: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lease, "POLL", 0.01)
    found, place = file_system(f"file://{store}", own=True)
    (store / "doc.txt").write_bytes(MINE)
    with Lease(found, place, expiry=0.01, beat=0.01):
        pass
    assert (store / "doc.txt").read_bytes() == MINE
    (store / ".leases").symlink_to(mine)
    with pytest.raises(StoreError), Lease(found, f"{place}/.leases", expiry=0.01, beat=0.01):
        pass
    assert untouched(mine)


def test_copies_are_not_made_through_links(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(HOME, str(tmp_path / "copies"))
    copy = folder_of("file:///museum", "runs")
    copy.mkdir(parents=True)
    (copy / "hall").symlink_to(mine)
    other = folder_of("file:///hall", "scenes")
    other.parent.mkdir()
    other.symlink_to(mine)
    (copy / quota.MARK).symlink_to(mine / "mark")
    for folder in (copy / "hall", other):
        with pytest.raises(RunFolderError, match="link"):
            quota.claim(QUIET, folder)
    quota.claim(QUIET, copy)
    assert untouched(mine) and (copy / quota.MARK).is_file()


@pytest.mark.parametrize("name", ["rows", "outputs", "hall"])
def test_a_batch_writes_through_no_link(
    tmp_path: Path, mine: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    write_project(tmp_path / "hall", names=[f"{k}.png" for k in range(6)], dots=True)
    table, folder = tmp_path / "t.toml", tmp_path / "runs"
    table.write_text(f"[scenes.hall]\nscene = 'hall'\nroi = ['{BOX}']\n", encoding="utf-8")
    folder.mkdir()
    (folder / name).symlink_to(mine)
    assert "link" in refused(capsys, "batch", table, "--run-dir", folder)
    assert untouched(mine)


@pytest.mark.parametrize("name", ["", "hall"])
@pytest.mark.parametrize("more", [[], ["--dry-run"]])
def test_a_batch_on_a_store_deletes_nothing_through_a_link_here(
    tmp_path: Path,
    store: Path,
    mine: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    more: list[str],
) -> None:
    monkeypatch.setenv(HOME, str(tmp_path / "copies"))
    url = f"file://{tmp_path / 'runs'}"
    link = folder_of(url, "batches") / name
    link.parent.mkdir(parents=True)
    for own in ("batch.json", "report.html", "report.json", "manifest.json"):
        (mine / own).write_bytes(MINE)
    link.symlink_to(mine)
    table = tmp_path / "t.toml"
    table.write_text(f"[scenes.hall]\nscene = 'hall'\nroi = ['{BOX}']\n", encoding="utf-8")
    there = {path.name for path in mine.iterdir()}
    assert "is a link" in refused(capsys, "batch", table, "--run-dir", url, *more)
    assert {path.name for path in mine.iterdir() if path.read_bytes() == MINE} == there


def test_a_number_of_a_commit_is_small(store: Path, run: Path) -> None:
    stored = stored_run(f"file://{store}", "hall")
    stored.publish(run, "scene", last=False)
    body = stored._commits()[0] | {"serial": 10**4000}
    with pytest.raises(EngineError, match="not a commit"):
        commits._checked(body, "there")
