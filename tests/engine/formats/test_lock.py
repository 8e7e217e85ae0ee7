"""The lock of a run folder: one holder, gone with it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from roigs_engine.errors import RunFolderError
from roigs_engine.formats import lock
from roigs_engine.formats.lock import check_held, holder, locked
from roigs_engine.formats.run_files import BATCH_LOCK, CLUSTER_LOCK, LOCK
from tests.engine.other_process import in_the_middle

ROOT = Path(__file__).resolve().parents[3]
HOLD = """
import sys
from pathlib import Path
from threading import Barrier
from roigs_engine.formats.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_file_says_who_and_goes_with_the_block(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    with locked(folder):
        (folder / "events.jsonl").write_text("{}\n", encoding="utf-8")
        record = json.loads((folder / "run.lock").read_text(encoding="utf-8"))
        assert record["pid"] == os.getpid() and record["started"] > 1.7e9
        assert record["events_from"] == 0
    assert [path.name for path in folder.iterdir()] == ["events.jsonl"]
    with locked(folder):
        record = json.loads((folder / "run.lock").read_text(encoding="utf-8"))
        assert record["events_from"] == 3


def test_a_folder_that_stays_empty_goes_too(tmp_path: Path) -> None:
    with locked(tmp_path / "run"):
        pass
    assert not (tmp_path / "run").exists()


def test_another_process_is_kept_out_until_it_dies(tmp_path: Path) -> None:
    with in_the_middle(HOLD, tmp_path, "held") as engine:
        with pytest.raises(RunFolderError, match=f"process {engine.pid}"), locked(tmp_path):
            pass
        engine.kill()
    assert (tmp_path / "run.lock").exists()
    with locked(tmp_path):
        assert json.loads((tmp_path / "run.lock").read_text(encoding="utf-8"))["pid"] == os.getpid()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"Cannot write .*file \("), locked(tmp_path / "file"):
        pass


def test_others_see_who_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    assert holder(path) == 0
    with locked(tmp_path):
        assert holder(path) == os.getpid()
    tmp_path.mkdir(exist_ok=True)
    path.write_text("nobody", encoding="utf-8")  # as a killed engine leaves it
    assert holder(path) == 0


# --- a lock that is lost ---


@pytest.mark.skipif(os.name != "posix", reason="Windows does not delete what is open")
def test_a_deleted_lock_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    with locked(tmp_path):
        check_held(tmp_path / "scene")
        path.unlink()
        check_held(tmp_path.parent)  # of another folder
        with pytest.raises(RunFolderError, match="deleted or replaced"):
            check_held(tmp_path / "scene")
        with in_the_middle(HOLD, tmp_path, "held") as engine:
            with pytest.raises(RunFolderError, match="deleted or replaced"):
                check_held(tmp_path)
            assert holder(path) == engine.pid
    check_held(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="Windows does not delete what is open")
def test_the_end_does_not_delete_the_lock_of_another(tmp_path: Path) -> None:
    path = tmp_path / "run.lock"
    with locked(tmp_path):
        path.unlink()
        with in_the_middle(HOLD, tmp_path, "held") as engine:
            with locked(tmp_path / "other"):
                pass
            engine.kill()
        left = path.read_bytes()
    assert path.read_bytes() == left


# --- file systems without locks ---


@pytest.fixture(params=[errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def no_locks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_: object) -> None:
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(fcntl, "flock", refuse)


def left_by(folder: Path, **record: object) -> Path:
    """The lock file of an engine of this computer that has ended, with other values."""
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    folder.mkdir(exist_ok=True)
    values = {"pid": ended.pid, "started": 1.8e9, **lock.identity(), **record}
    (folder / "run.lock").write_text(json.dumps(values), encoding="utf-8")
    return folder / "run.lock"


@pytest.mark.usefixtures("no_locks")
def test_without_locks_the_file_is_the_lock(tmp_path: Path) -> None:
    texts: list[str] = []
    path = tmp_path / "run" / "run.lock"
    with locked(tmp_path / "run", texts.append):
        assert len(texts) == 1 and "no locks" in texts[0] and "\n" not in texts[0]
        assert json.loads(path.read_text(encoding="utf-8"))["pid"] == os.getpid()
        assert holder(path) == os.getpid()
        refused = pytest.raises(RunFolderError, match=f"process {os.getpid()}")
        with refused, locked(tmp_path / "run"):
            pass
        check_held(tmp_path / "run")
    assert not path.parent.exists()


@pytest.mark.usefixtures("no_locks")
def test_without_locks_a_dead_process_is_followed(tmp_path: Path) -> None:
    for record in ({}, {"pid": os.getpid(), "start": "another start"}):
        path = left_by(tmp_path, **record)
        assert holder(path) == 0
        with locked(tmp_path):
            assert json.loads(path.read_text(encoding="utf-8"))["pid"] == os.getpid()
        assert not path.exists()


@pytest.mark.usefixtures("no_locks")
@pytest.mark.parametrize("record", [{"host": "another"}, {"pid": "x"}, {"pid": -1}, {"pid": True}])
def test_without_locks_what_may_live_is_refused_with_a_way_out(
    tmp_path: Path, record: dict[str, object]
) -> None:
    path = left_by(tmp_path, **record)
    before = path.read_bytes()
    with pytest.raises(RunFolderError) as caught, locked(tmp_path):
        pass
    assert f"delete {path}" in caught.value.hint
    assert str(record.get("host", "")) in caught.value.message
    assert path.read_bytes() == before


@pytest.mark.usefixtures("no_locks")
def test_without_locks_a_lost_lock_is_noticed(tmp_path: Path) -> None:
    with locked(tmp_path):
        (tmp_path / "run.lock").unlink()
        with pytest.raises(RunFolderError, match="deleted or replaced"):
            check_held(tmp_path)


@pytest.mark.usefixtures("no_locks")
@pytest.mark.parametrize(("links", "dead"), [(True, True), (True, False), (False, False)])
def test_without_locks_one_of_many_gets_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool, dead: bool
) -> None:
    """All start at once; on some network drives there are no hard links either."""

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
        left_by(tmp_path / "run")
        with locked(tmp_path / "run"):  # one at a time takes over
            pass
    start, end = Barrier(8), Barrier(8)

    def hold(number: int) -> bool:
        start.wait()
        try:
            with locked(tmp_path / "run"):
                end.wait()
                return True
        except RunFolderError:
            end.wait()
            return False

    for _ in range(10):
        if dead:
            left_by(tmp_path / "run")
        with ThreadPoolExecutor(8) as pool:
            assert sum(pool.map(hold, range(8))) == 1
        assert not (tmp_path / "run").exists()


TEXTS = ('{"name": "of another program"}', "mine", "[]", "5", '{"pid": 1}')


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("name", [LOCK, BATCH_LOCK, CLUSTER_LOCK, "lod-meta.lock"])
def test_a_file_of_another_program_stays(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with (
        pytest.raises(RunFolderError, match="was not written by the engine"),
        locked(tmp_path, name=name),
    ):
        pass
    assert (tmp_path / name).read_text() == text


@pytest.mark.parametrize("content", [b"", bytes(80), b"\n"])
def test_what_a_crash_has_left_of_a_record_is_taken_over(tmp_path: Path, content: bytes) -> None:
    (tmp_path / LOCK).write_bytes(content)
    with locked(tmp_path):
        assert holder(tmp_path / LOCK) == os.getpid()
    assert not list(tmp_path.glob("*"))
