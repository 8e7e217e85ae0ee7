"""Links, pipes and devices in a run folder: nothing is written through one, nothing waits."""

from __future__ import annotations

import os
import re
import shutil
from functools import partial
from pathlib import Path

import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.formats.files import read_json, remove_leftovers
from roigs_engine.formats.lock import holder, locked
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.training.checkpoint import load_checkpoint
from tests.engine.killing import Request, contents, engine
from tests.engine.runs import stage_of
from tests.waiting import at_most

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the engine is forked")
MINE = b"mine, and not the engine's"
READ_FIRST = {"manifest.json", "provenance.json", "stages.json", "stage.json"}
READ_LATER = {"checkpoint.bin", "checkpoint.before.bin", "model.ply"}


def paths(run: Path, *, folders: bool) -> list[Path]:
    """Every file, or every folder, that a run writes, relative to it."""
    found = [path for path in sorted(run.rglob("*")) if path.is_dir() == folders]
    extra = [] if folders else [run / "run.lock", run / "preview.ply"]
    return [path.relative_to(run) for path in (*found, *extra)]


def previewing(request: Request, run: Path) -> list[object]:
    return [*request.arguments(run), "--preview-seconds", "1e-6"]


def planted(request: Request, run: Path, elsewhere: Path, *, hard: bool) -> list[Path]:
    """A folder with a link at each name that a run writes; returns what they lead to."""
    targets = []
    elsewhere.mkdir()
    for number, path in enumerate(paths(request.whole, folders=False)):
        if path.name in READ_FIRST | READ_LATER:
            continue
        target = elsewhere / f"{number}"
        own = path.name == "split.json"  # it tells that the folder is a run's
        target.write_bytes((request.whole / path).read_bytes() if own else MINE)
        (run / path).parent.mkdir(parents=True, exist_ok=True)
        (run / path).hardlink_to(target) if hard else (run / path).symlink_to(target)
        targets.append(target)
    shutil.rmtree(run / "cache")  # what is there is used, not written
    return targets


@pytest.mark.parametrize("hard", [False, True])
def test_no_file_is_written_through_a_link(request_: Request, tmp_path: Path, hard: bool) -> None:
    targets = planted(request_, tmp_path / "run", tmp_path / "elsewhere", hard=hard)
    assert len(targets) > 12
    before = [target.read_bytes() for target in targets]
    ended = engine(previewing(request_, tmp_path / "run"))
    assert ended.status == 0, ended.errors
    assert [target.read_bytes() for target in targets] == before
    assert not [path for path in (tmp_path / "run").rglob("*") if path.is_symlink()]
    assert not (tmp_path / "run" / "run.lock").exists()


@pytest.mark.parametrize("hard", [False, True])
def test_what_a_resumed_run_reads_is_not_written_through_links(
    request_: Request, tmp_path: Path, hard: bool
) -> None:
    """Stopped within the second stage; each file is then a link to a copy of itself."""
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    engine(request_.arguments(run), request_.moment("^object-thing: half of checkpoint"))
    shutil.copytree(run, elsewhere)
    before = {path: path.read_bytes() for path in elsewhere.rglob("*") if path.is_file()}
    for target in before:
        path = run / target.relative_to(elsewhere)
        path.unlink()
        path.hardlink_to(target) if hard else path.symlink_to(target)
    assert engine(request_.arguments(run)).status == 0
    assert {path: path.read_bytes() for path in before} == before
    assert contents(run) == contents(request_.whole)


def test_every_linked_folder_is_refused(request_: Request, tmp_path: Path) -> None:
    folders = [*paths(request_.whole, folders=True), Path("earlier"), Path("blender")]
    assert {"rois", "coarse", "selection", "stages", "crops"} <= {path.name for path in folders}
    for number, path in enumerate(folders):
        run, target = tmp_path / f"run {number}", tmp_path / f"target {number}"
        (run / path).parent.mkdir(parents=True)
        target.mkdir()
        (run / path).symlink_to(target)
        ended = engine(request_.arguments(run))
        assert ended.status == 2 and "Traceback" not in ended.errors
        assert f"{run / path} is a link" in ended.errors.splitlines()[-1]
        assert not list(target.iterdir())


@pytest.mark.parametrize("command", ["surface", "levels"])
def test_no_command_writes_through_a_linked_folder(
    request_: Request, tmp_path: Path, command: str
) -> None:
    run, target = tmp_path / "run", tmp_path / "target"
    shutil.copytree(request_.whole, run)
    shutil.rmtree(run / "cache")
    target.mkdir()
    (run / "cache").symlink_to(target)
    ended = engine([command, run])
    assert ended.status == 2 and f"{run / 'cache'} is a link" in ended.errors.splitlines()[-1]
    assert not list(target.iterdir())


def test_the_run_folder_itself_may_be_a_link(request_: Request, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    assert engine(request_.arguments(tmp_path / "run")).status == 0
    assert contents(tmp_path / "disk") == contents(request_.whole)


def test_a_linked_folder_that_comes_later(request_: Request, tmp_path: Path) -> None:
    """One that leads nowhere is no folder when the run starts."""
    (tmp_path / "rois").symlink_to(tmp_path.parent / "nowhere")
    ended = engine(request_.arguments(tmp_path))
    assert ended.status == 2
    assert f"{tmp_path / 'rois'} is a link" in ended.errors.splitlines()[-1]
    assert not (tmp_path / "stages").exists()


@pytest.mark.parametrize("name", ["manifest.json", "provenance.json", "run.lock", "events.jsonl"])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_pipes_devices_and_folders_are_one_line(
    request_: Request, tmp_path: Path, name: str, kind: str
) -> None:
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    ended = engine(request_.arguments(tmp_path))
    if kind == "device" and name == "run.lock":  # a link is replaced
        assert ended.status == 0
        return
    assert ended.status == 2 and "Traceback" not in ended.errors
    last = ended.errors.splitlines()[-1]
    assert str(path) in last and "space" not in last


@pytest.mark.parametrize("name", ["rois", "stages", "selection", "cache"])
def test_a_file_in_the_place_of_a_folder_is_one_line(
    request_: Request, tmp_path: Path, name: str
) -> None:
    (tmp_path / name).write_bytes(MINE)
    ended = engine(request_.arguments(tmp_path))
    last = ended.errors.splitlines()[-1]
    assert ended.status == 2 and str(tmp_path / name) in last
    assert re.search(r"Move (its files away|away the file of that name), or choose another", last)
    assert (tmp_path / name).read_bytes() == MINE and not list(tmp_path.rglob("model.ply"))


@pytest.mark.parametrize("name", ["stage.json", "model.ply", "checkpoint.bin"])
def test_pipes_in_a_stage_are_one_line(request_: Request, tmp_path: Path, name: str) -> None:
    shutil.copytree(request_.whole, tmp_path / "run")
    path = stage_of(tmp_path / "run", "scene") / name
    if name == "checkpoint.bin":
        (path.parent / "stage.json").unlink()
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    ended = engine(request_.arguments(tmp_path / "run"))
    assert ended.status == 2 and "Traceback" not in ended.errors
    assert str(path) in ended.errors.splitlines()[-1]


def test_reading_a_pipe_does_not_wait(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with at_most(10, TimeoutError("it hangs")):
        for read in (read_json, read_ply, partial(load_checkpoint, fingerprint="one")):
            with pytest.raises(RunFolderError):
                read(path)
        assert holder(path) == 0
        remove_leftovers(tmp_path)


def test_a_linked_lock_is_not_taken_from_its_holder(tmp_path: Path) -> None:
    """One file under two names: the other one's engine is at work."""
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with locked(tmp_path / "a"):
        (tmp_path / "b" / "run.lock").hardlink_to(tmp_path / "a" / "run.lock")
        with pytest.raises(RunFolderError, match="Another engine"), locked(tmp_path / "b"):
            pass
