"""Families: stores that somebody else has written to, and stores that fail at any call.

A store is a folder of the case, by a `file:` address. Engines are replaced by the files of a run.
"""

from __future__ import annotations

import functools
import json
import os
import random
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from roigs_engine.app.batch import run_batch
from roigs_engine.app.outputs import Result
from roigs_engine.batch import staged
from roigs_engine.batch.engine_process import DONE, Outcome
from roigs_engine.batch.staged import stored_run
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import EngineError
from roigs_engine.formats.text import json_digest
from roigs_engine.requests.declare import Request, option
from roigs_engine.requests.runs import Batch
from roigs_engine.requests.values import PATH
from roigs_engine.storage import urls
from roigs_engine.storage.lease import Lease
from tests.fuzz.cases import Case, good_boxes, good_scene, json_bytes, odd_tree, write
from tests.fuzz.damage import ODD_TEXTS, ODD_VALUES, bytes_damaged
from tests.fuzz.failing_store import ERRORS, MOMENTS, SILENT, Countdown, failing
from tests.fuzz.run_folders import run_files

RUN = "hall"
HOSTILE = (
    *ODD_TEXTS,
    *("/tmp/roigs-stolen", "a/../../../../stolen", "a\\..\\..\\stolen", "C:\\stolen", "C:stolen"),
    *("//host/share/stolen", "\\\\?\\C:\\stolen", "file:///tmp/stolen", "~/stolen", "a//b", "./a"),
    *("manifest.json/x", "rois", "a/" * 3000 + "x", "nul", "x:y", "a\u2028b", "selection/x\0y"),
    *(".commits/x.json", "run.lock", ".roigs-copy", "events.jsonl", "\udc80"),
)
"""Names that a file may say."""


@dataclass(frozen=True, kw_only=True)
class StoreWork(Request):
    """Work on a store, and how it fails."""

    plan: Path = option(PATH, "file", required=True, flags=())


def engine(argv: Any, emit: Any, should_stop: Any) -> Outcome:
    """In place of an engine's process: a run folder, or a file of `convert`, is there at once."""
    if argv[0] == "convert":
        write(Path(argv[-1]), b"converted")
    else:
        for name, data in run_files().items():
            write(Path(argv[argv.index("--run-dir") + 1]) / name, data)
    return Outcome(state=DONE)


@contextmanager
def a_machine(home: Path) -> Iterator[None]:
    """A machine whose copies are there, with engines as above; dead leases end soon."""
    brief = {"expiry": 0.1, "beat": 0.03}
    assert Lease.__init__.__kwdefaults__
    with (
        mock.patch.dict(os.environ, {"ROIGS_CACHE": str(home)}),
        mock.patch.object(staged, "run_engine", engine),
        mock.patch.object(urls, "SILENT", 0.5),
        mock.patch.dict(Lease.__init__.__kwdefaults__, brief),
    ):
        yield


def work_on_store(request: Any, context: Context) -> Result:
    """Fetch a run, or do a batch, on a store; after an outage, all is well with the same command.

    `plan` has `work`, `url`, the `table`, and `calls`: first, how many, moment and error.
    """
    plan = json.loads(request.plan.read_bytes())
    home, calls = request.plan.parent.parent / "out", plan["calls"]
    whole = dict(run_files())
    full = {"ROIGS_CACHE_GB": plan.get("gigabytes", "50")}
    with a_machine(home / "copies"), mock.patch.dict(os.environ, full):
        if plan["work"] == "fetch":
            stored_run(plan["url"], RUN).fetch(home / "got")
            return Result()
        batch = Batch(table=Path(plan["table"]), run_dir=plan["url"])
        try:
            with failing(Countdown(*calls[:2], tuple(calls[2:]))):
                result = run_batch(batch, context)
            error = result.error
        except EngineError as raised:
            error = raised
        if calls[1]:
            again = run_batch(batch, QUIET)
            assert not again.error, again.error
            stored_run(plan["url"], RUN).fetch(home / "whole")
            found = home / "whole"
            names = [str(p.relative_to(found)) for p in found.rglob("*") if p.is_file()]
            assert {name: (found / name).read_bytes() for name in names} == whole
        if error:
            raise error
    return Result()


@functools.cache
def published() -> dict[str, bytes]:
    """The files of a store with a run in two commits."""
    with tempfile.TemporaryDirectory() as name:
        url = (Path(name) / "runs").as_uri()
        folder = Path(name) / "run"
        write(folder / "selection" / "thing.json", b"{}")
        stored_run(url, RUN).publish(folder, "scene", last=False)
        for file in ("result.ply", "rois/thing.ply", "manifest.json"):
            write(folder / file, run_files()[file])
        stored_run(url, RUN).publish(folder, "joint", last=False)
        home = Path(name) / "runs"
        return {
            p.relative_to(home).as_posix(): p.read_bytes() for p in home.rglob("*") if p.is_file()
        }


def signed(body: Any) -> Any:
    """The commit as somebody who knows the format writes it."""
    if isinstance(body, dict):
        body.pop("digest", None)
        body["digest"] = json_digest(body | {"run": RUN})
    return body


def commits(dice: random.Random, folder: Path) -> Case:
    """Commits of any content, whose digest is right, with objects and leases of any content."""
    files, store = dict(published()), folder / "out" / "runs"
    for name in [name for name in files if "/.commits/" in name]:
        body = json.loads(files[name])
        entry = next(iter(body["files"].values()))
        match dice.randrange(8):
            case 0:
                body["files"] = {dice.choice(HOSTILE): entry for _ in range(dice.randint(1, 3))}
            case 1:
                body["gone"] = [dice.choice(HOSTILE), "manifest.json"]
            case 2:
                entry[dice.choice(("at", "sha", "size"))] = dice.choice((*HOSTILE, *ODD_VALUES))
            case 3:
                body[dice.choice(list(body))] = dice.choice(ODD_VALUES)
            case 4:
                del body[dice.choice(list(body))]
            case 5:
                body = json.loads(json.dumps(odd_tree(dice, body)))
        files[name] = json_bytes(dice, signed(body)) if dice.random() < 0.9 else b"[" * 300_000
    for name in dice.sample(list(files), dice.randrange(2)):
        files[name] = bytes_damaged(dice, files[name])
    for lease in ("batch", "scene", "all"):
        if dice.random() < 0.3:
            state = {"state": dice.choice(("held", "claim", *ODD_VALUES)), "count": 1}
            files[f"{RUN}/.leases/{lease}/{dice.randrange(99)}"] = json_bytes(dice, state)
            files[f".leases/{lease}/{dice.randrange(99)}"] = json_bytes(dice, state)
    if dice.random() < 0.5:
        record = {"version": 2, "scenes": {RUN: {"row": "x", "files": {}, "outputs": {"a": []}}}}
        files["batch.json"] = json_bytes(dice, odd_tree(dice, record))
    for name, data in files.items():
        write(store / name, data)
    return on_store(folder, "fetch" if dice.random() < 0.7 else "batch", store, (0, 0, "", ""))


def outages(dice: random.Random, folder: Path) -> Case:
    """A batch on a store that fails at some call; what it was to do is done by the next one."""
    count = dice.choice((1, 1, 1, 2, 5, 1000))
    calls = (
        dice.randint(1, MOST_CALLS),
        count,
        dice.choice((*MOMENTS, SILENT)),
        dice.choice(list(ERRORS)),
    )
    return on_store(folder, "batch", folder / "out" / "runs", calls)


MOST_CALLS = 260
"""Of a batch of one scene and one output, and some more."""


def on_store(folder: Path, work: str, store: Path, calls: tuple[int, int, str, str]) -> Case:
    rois, scene = Path(good_boxes(folder)), good_scene(folder)
    row = f"""outputs = ["splat"]\n[scenes.{RUN}]\nscene = "{scene.as_uri()}"\nrois = '{rois}'
only = ["thing"]\nmax_side = 24\ndevice = "cpu"\ntest_every = 4\n"""
    table = write(folder / "in" / "museum.toml", f"[defaults]\n{row}")
    plan = {"work": work, "url": store.as_uri(), "table": str(table), "calls": calls}
    return Case(["store", str(write(folder / "in" / "plan.json", json.dumps(plan)))])


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "store_commits": (commits, 250),
    "store_outages": (outages, 100),
}
