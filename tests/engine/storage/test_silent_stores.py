"""Stores that never answer: a stop is heard, and without one the command ends with one line."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from roigs_engine.app.batch import run_batch
from roigs_engine.batch import staged
from roigs_engine.batch.engine_process import LOST, STOPPED
from roigs_engine.batch.parts import Part, Staging
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.requests.runs import Batch
from roigs_engine.storage import urls
from roigs_engine.storage.mirror import mirror
from roigs_engine.storage.urls import FileSystem, StoreError

CALLS = ("find", "info", "exists", "cat_file", "pipe_file", "makedirs", "rm_file")
URL = "s3://museum/runs"


class Silent:
    """A file system whose calls wait until the test is over."""

    def __init__(self) -> None:
        self.over, self.calls = threading.Event(), list[str]()

    def __getattr__(self, name: str) -> Any:
        def call(*given: Any, **options: Any) -> None:
            self.calls.append(name)
            self.over.wait()
            raise ConnectionResetError

        return call


@pytest.fixture
def silent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Silent]:
    """The store of all addresses; its calls are abandoned soon."""
    fsspec = pytest.importorskip("fsspec")
    found = Silent()
    monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "home"))
    monkeypatch.setattr(fsspec.core, "url_to_fs", lambda url, **_: (found, "museum/runs"))
    for name, seconds in (("SILENT", 0.5), ("GRACE", 0.2), ("UPLOAD", 0.4)):
        monkeypatch.setattr(urls, name, seconds)
    yield found
    found.over.set()


def stopped_after_a_call(store: Silent) -> Callable[[], bool]:
    return lambda: bool(store.calls)


@pytest.mark.parametrize("name", [*CALLS, "get_file", "put_file", "upload"])
def test_every_call_hears_a_stop(silent: Silent, name: str) -> None:
    found = FileSystem(silent, URL, should_stop=stopped_after_a_call(silent))
    with pytest.raises(Stopped):
        getattr(found, name)(io.BytesIO() if name == "upload" else "x", "y")
    assert len(silent.calls) == 1


@pytest.mark.parametrize("name", [*CALLS, "get_file", "put_file", "upload"])
def test_every_call_ends(silent: Silent, name: str) -> None:
    with pytest.raises(StoreError, match=r"Cannot use s3://museum/runs \(it does not answer\)"):
        getattr(FileSystem(silent, URL), name)(io.BytesIO(b"x") if name == "upload" else "x", "y")


def test_a_copy_goes_on_while_its_file_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urls, "SILENT", 1.0)

    def slowly(source: str, target: str) -> None:
        for size in range(8):
            Path(target).write_bytes(bytes(size))
            time.sleep(0.3)

    FileSystem(SimpleNamespace(get_file=slowly), URL).get_file("x", str(tmp_path / "y"))
    assert (tmp_path / "y").stat().st_size == 7


def test_after_a_call_that_was_given_up_others_end_at_once(silent: Silent) -> None:
    found = FileSystem(silent, URL, should_stop=stopped_after_a_call(silent))
    with pytest.raises(Stopped):
        found.info("x")
    began = time.monotonic()
    for name in CALLS:
        with pytest.raises(Stopped):
            getattr(found, name)("x")
    assert time.monotonic() - began < len(CALLS) * urls.GRACE


def test_an_upload_that_takes_long_is_finished_after_a_stop(
    silent: Silent, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urls, "UPLOAD", 30.0)
    written = list[bytes]()

    def slowly(*_: object) -> Any:
        time.sleep(3 * urls.GRACE)
        return nullcontext(SimpleNamespace(write=written.append))

    slow = SimpleNamespace(open=slowly)
    FileSystem(slow, URL, should_stop=lambda: True).upload(io.BytesIO(b"work"), "x")
    assert written == [b"work"]


@pytest.mark.parametrize("dry", [True, False])
@pytest.mark.parametrize("stop", [True, False])
def test_a_batch_ends(silent: Silent, tmp_path: Path, dry: bool, stop: bool) -> None:
    table = tmp_path / "t.toml"
    table.write_text("[scenes.hall]\nscene = 'scan'\nroi = ['auto']\n", encoding="utf-8")
    request = Batch(table=table, run_dir=URL, dry_run=dry)
    context = Context(should_stop=stopped_after_a_call(silent)) if stop else QUIET
    began = time.monotonic()
    with pytest.raises(Stopped if stop else RunFolderError):
        run_batch(request, context)
    assert time.monotonic() - began < 30


@pytest.mark.parametrize("stop", [True, False])
def test_a_part_and_a_copy_end(silent: Silent, stop: bool) -> None:
    should_stop = stopped_after_a_call(silent) if stop else lambda: False
    part = Part(
        scene="hall",
        name="scene",
        argv=("run",),
        staging=Staging(url=URL, base="x", options={}),
    )
    outcome = staged.run_part(part, 1, lambda event: None, should_stop)
    assert outcome.state == (STOPPED if stop else LOST)
    with pytest.raises(Stopped if stop else StoreError):
        mirror("s3://museum/scans/hall", Context(should_stop=should_stop))
