"""Copies of scenes: each file is read once; the copies used longest ago make room."""

from __future__ import annotations

import io
import json
import os
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.batch.staged import stored_run
from roigs_engine.context import QUIET
from roigs_engine.errors import ConfigError, RunFolderError
from roigs_engine.formats.lock import locked
from roigs_engine.formats.run_files import BATCH_LOCK
from roigs_engine.requests.values import is_url
from roigs_engine.storage import mirror as mirror_module
from roigs_engine.storage.mirror import mirror
from roigs_engine.storage.quota import REMOVED, claim, enforce_quota, keep, make_copy
from roigs_engine.storage.urls import StoreError, reason

URL = "memory://museum/scans/{}"


@pytest.fixture
def store(memory_store: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A store with two scenes, and a record of the files that are read."""
    found = memory_store
    for scene in ("hall", "attic"):
        for name in ("images/1.png", "images/2.png"):
            found.pipe(f"/museum/scans/{scene}/{name}", f"{scene} {name}".encode() * 1000)
    found.read = []
    real = type(found).get_file
    monkeypatch.setattr(
        type(found),
        "get_file",
        lambda self, path, *rest: (found.read.append(path), real(self, path, *rest)),
    )
    return found


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize("what", ["scene", "run"])
def test_a_killed_copy_leaves_nothing_for_long(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.ply").write_bytes(b"made")
    run = stored_run("memory://museum/runs", "hall")
    run.publish(tmp_path / "run", "all", last=True)

    def copy() -> Path:
        if what == "scene":
            return mirror(URL.format("hall"), QUIET)
        run.fetch(tmp_path / "copy")
        return tmp_path / "copy"

    if not (child := os.fork()):
        monkeypatch.setattr(os, "replace", lambda *_: os._exit(0))
        copy()
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
    names = {path.name for path in copy().rglob("*") if path.is_file()}
    assert names == ({"1.png", "2.png"} if what == "scene" else {"result.ply"})


def test_a_file_is_read_once_until_it_changes(store: Any) -> None:
    folder = mirror(URL.format("hall"), QUIET)
    assert (folder / "images" / "1.png").read_bytes() == b"hall images/1.png" * 1000
    assert len(store.read) == 2
    assert mirror(URL.format("hall"), QUIET) == folder and len(store.read) == 2
    time.sleep(0.01)
    store.pipe("/museum/scans/hall/images/1.png", b"other")
    store.rm("/museum/scans/hall/images/2.png")
    mirror(URL.format("hall"), QUIET)
    assert (folder / "images" / "1.png").read_bytes() == b"other" and len(store.read) == 3
    assert not (folder / "images" / "2.png").exists()
    (folder / "images" / "1.png").write_bytes(b"cut")  # as a full disk leaves it
    mirror(URL.format("hall"), QUIET)
    assert (folder / "images" / "1.png").read_bytes() == b"other"


def test_a_copy_of_a_killed_engine_is_not_taken_for_another(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A, then B until it is killed, then A again, which some stores tell by its content alone."""
    name, (a, b) = "/museum/scans/hall/images/1.png", (b"a" * 9, b"b" * 9)

    def put(data: bytes) -> None:
        store.pipe(name, data)
        monkeypatch.setattr(mirror_module, "sign", lambda facts: [facts["size"], str(marks[data])])

    marks = {a: "a", b: "b"}
    put(a)
    folder = mirror(URL.format("hall"), QUIET)
    put(b)
    with monkeypatch.context() as killed:
        real = mirror_module.write_json

        def write(path: Path, value: Any) -> None:
            if "images/1.png" in value:
                raise KeyboardInterrupt
            real(path, value)

        killed.setattr(mirror_module, "write_json", write)
        with pytest.raises(KeyboardInterrupt):
            mirror(URL.format("hall"), QUIET)
    assert (folder / "images" / "1.png").read_bytes() == b
    put(a)
    mirror(URL.format("hall"), QUIET)
    assert (folder / "images" / "1.png").read_bytes() == a


@pytest.mark.parametrize("marker", ["images/", "images", "empty/", ""])
def test_markers_of_folders_are_no_files(
    store: Any, monkeypatch: pytest.MonkeyPatch, marker: str
) -> None:
    real = type(store).find

    def find(self: Any, place: str, **options: Any) -> Any:
        found = real(self, place, **options)
        return {f"{place}/{marker}": {"size": 0, "type": "file"}} | found

    monkeypatch.setattr(type(store), "find", find)
    folder = mirror(URL.format("hall"), QUIET)
    assert {path.name for path in (folder / "images").iterdir()} == {"1.png", "2.png"}
    assert not (folder / "empty").exists()


@pytest.mark.parametrize("name", ["/x.png", "a//x.png", "a" * 300, "ä" * 128 + "/x.png", "images"])
def test_a_name_that_no_file_can_have_is_named(
    store: Any, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    real = type(store).find

    def find(self: Any, place: str, **options: Any) -> Any:
        return real(self, place, **options) | {f"{place}/{name}": {"size": 9, "type": "file"}}

    monkeypatch.setattr(type(store), "find", find)
    with pytest.raises(ConfigError, match="cannot name a file here") as error:
        mirror(URL.format("hall"), QUIET)
    assert error.value.hint == "Rename it there."


def test_the_limit(store: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    hall = mirror(URL.format("hall"), QUIET)
    monkeypatch.setenv("ROIGS_CACHE_GB", "0.00005")
    mirror(URL.format("attic"), QUIET)
    assert hall.exists()  # used within the hour: maybe by an engine that is at work
    old = time.time() - 7200
    os.utime(hall.parent, (old, old))
    attic = mirror(URL.format("attic"), QUIET)
    assert attic.exists() and not hall.exists()
    monkeypatch.setenv("ROIGS_CACHE_GB", "much")
    with pytest.raises(ConfigError, match="ROIGS_CACHE_GB is 'much'"):
        mirror(URL.format("attic"), QUIET)


def test_run_folders_are_within_the_same_limit(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = time.time() - 7200
    home = tmp_path / "home"
    runs = {name: home / "runs" / f"{1:020x}" / name for name in ("hall", "attic", "new")}
    batches = {name: home / "batches" / f"{k:020x}" for k, name in enumerate(("over", "at work"))}
    for folder in (*runs.values(), *batches.values()):
        make_copy(folder)
        (folder / "result.ply").write_bytes(bytes(20_000))
        os.utime(folder, (old, old))
    claim(QUIET, runs["new"])
    with locked(batches["at work"], name=BATCH_LOCK):
        os.utime(batches["at work"], (old, old))
        mirror(URL.format("hall"), QUIET)
        assert all(folder.exists() for folder in (*runs.values(), *batches.values()))
        monkeypatch.setenv("ROIGS_CACHE_GB", "0.00009")  # three of these
        keep(runs["attic"])  # another engine has begun to work there
        enforce_quota()
        left = {name for name, folder in (runs | batches).items() if folder.exists()}
    assert left == {"attic", "new", "at work"}
    assert not (home / REMOVED).exists()
    os.utime(batches["at work"], (old, old))  # it has ended: nothing holds its folder
    enforce_quota()
    assert not batches["at work"].exists() and runs["attic"].exists()


def test_what_an_address_is() -> None:
    assert is_url("s3://bucket/a") and is_url("memory://a")
    assert not is_url("C:\\scans") and not is_url("/scans//a") and not is_url(Path("s3:/a"))


def test_folders_of_the_user_stay_in_whatever_folder_the_copies_are(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, mine = tmp_path / "home", tmp_path / "mine"
    names = ("scenes/vase", "runs/museum/hall", "batches/old", f"scenes/{2:020x}", "removed/x")
    old = time.time() - 7200
    for name in names:
        (home / name).mkdir(parents=True)
        (home / name / "photo.jpg").write_bytes(bytes(1000))
        os.utime(home / name, (old, old))
    (mine / f"{3:020x}").mkdir(parents=True)
    (mine / f"{3:020x}" / "photo.jpg").write_bytes(bytes(1000))
    make_copy(mine_linked := home / "runs" / f"{3:020x}" / "run")
    mine_linked.rmdir()
    mine_linked.symlink_to(mine / f"{3:020x}")
    monkeypatch.setenv("ROIGS_CACHE_GB", "0")
    mirror(URL.format("hall"), QUIET)
    enforce_quota()
    assert all((home / name / "photo.jpg").exists() for name in names)
    assert (mine / f"{3:020x}" / "photo.jpg").exists()


def test_an_index_that_others_wrote_deletes_nothing_elsewhere(store: Any, tmp_path: Path) -> None:
    folder = mirror(URL.format("hall"), QUIET)
    mine = tmp_path / "mine.txt"
    mine.write_bytes(b"mine")
    index = json.loads((folder.parent / "index.json").read_text(encoding="utf-8"))
    names = (str(mine), os.path.relpath(mine, folder), "..\\..\\mine.txt", "a\0b", "")
    index |= {name: [4, ""] for name in names}
    (folder.parent / "index.json").write_text(json.dumps(index), encoding="utf-8")
    mirror(URL.format("hall"), QUIET)
    assert mine.exists()


def test_copies_are_not_written_through_links(store: Any, tmp_path: Path) -> None:
    folder = mirror(URL.format("hall"), QUIET)
    (tmp_path / "mine").mkdir()
    for path in (folder / "images").iterdir():
        path.unlink()
    (folder / "images").rmdir()
    (folder / "images").symlink_to(tmp_path / "mine")
    with pytest.raises(RunFolderError, match="is a link"):
        mirror(URL.format("hall"), QUIET)
    assert not list((tmp_path / "mine").iterdir())


def test_files_of_others_beside_removed_copies_stay(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROIGS_CACHE_GB", "0")
    home = mirror(URL.format("hall"), QUIET).parents[2]
    for name in (f"{REMOVED}/mine/a.jpg", f"{REMOVED}/{5:032x}/a.jpg"):
        (home / name).parent.mkdir(parents=True)
        (home / name).write_bytes(b"mine")
    enforce_quota()
    assert [path.name for path in (home / REMOVED).iterdir()] == ["mine"]


def test_folders_behind_a_link_in_place_of_the_removed_copies_stay(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROIGS_CACHE_GB", "0")
    copy = mirror(URL.format("hall"), QUIET).parent
    theirs = tmp_path / "theirs" / f"{5:032x}" / "a.jpg"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(b"mine")
    (copy.parents[1] / REMOVED).symlink_to(tmp_path / "theirs")
    os.utime(copy, (0, 0))
    enforce_quota()
    assert theirs.read_bytes() == b"mine" and copy.exists()
    assert len(list((tmp_path / "theirs").iterdir())) == 1


class Pages(SimpleHTTPRequestHandler):
    """A web server of folders; `silent` ones do not tell sizes."""

    silent = False

    def log_message(self, format: str, *args: object) -> None:
        pass

    def list_directory(self, path: Any) -> Any:
        links = "".join(f'<a href="{p.name}{"/" * p.is_dir()}">x</a>' for p in Path(path).iterdir())
        page = f'<a href="gone.jpg">x</a>{links}'.encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(page)))
        self.end_headers()
        return io.BytesIO(page)

    def send_header(self, keyword: str, value: str) -> None:
        if not (self.silent and keyword == "Content-Length"):
            super().send_header(keyword, value)


@pytest.mark.parametrize("silent", [False, True])
def test_a_web_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, silent: bool) -> None:
    """Its lists have no sizes: each file is asked for its own."""
    pytest.importorskip("aiohttp")
    monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "home"))
    monkeypatch.setattr(Pages, "silent", silent)
    (tmp_path / "scan" / "images").mkdir(parents=True)
    (tmp_path / "scan" / "images" / "1.png").write_bytes(b"photo")
    make = partial(Pages, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), make) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/scan"
        if silent:
            with pytest.raises(StoreError, match="does not report the size"):
                mirror(url, QUIET)
        else:
            folder = mirror(url, QUIET)
            files = [p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()]
            assert files == ["images/1.png"]
        server.shutdown()


def test_a_run_folder_in_use_stays_although_the_clock_jumps(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [tmp_path / "home" / "runs" / ("a" * 20) / name for name in ("hall", "attic")]
    for run in runs:
        make_copy(run)
        (run / "result.ply").write_bytes(bytes(5000))
    monkeypatch.setenv("ROIGS_CACHE_GB", "0")
    with locked(runs[0]):
        later = time.time() + 1e5
        monkeypatch.setattr(time, "time", lambda: later)
        enforce_quota()
    assert [run.exists() for run in runs] == [True, False]


def test_errors_of_stores_do_not_tell_secrets() -> None:
    url = "http://me:hidden@host:9000/museum?token=hidden"
    said = reason(ValueError(f'Could not connect to the endpoint URL: "{url}" (x)'))
    assert said == 'Could not connect to the endpoint URL: "http://...@host:9000/museum?..." (x)'
