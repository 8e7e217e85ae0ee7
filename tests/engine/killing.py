"""An engine that is killed, stopped or hindered at the moment that a test wants.

A moment is a training step, an edit of the Gaussians, a question whether to stop (between photos,
picks and pictures) or a place within the writing of a file: half written, not yet renamed, just
renamed. It is named after the stage and what goes on: 'scene: half of checkpoint'.
"""

from __future__ import annotations

import functools
import io
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from roigs_engine import cli
from roigs_engine.commands.console import Console
from roigs_engine.commands.parser import build_parser
from roigs_engine.commands.process import run_process
from roigs_engine.commands.stopping import StopRequest
from roigs_engine.formats import files
from roigs_engine.requests.choices import PRESETS
from roigs_engine.requests.declare import options_of
from roigs_engine.requests.runs import Train
from roigs_engine.run import presets, stage_folder
from roigs_engine.run.config import RunConfig
from roigs_engine.training import trainer
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from tests.engine.faults import FAULTS, WITH_EVENTS, connect
from tests.engine.settings import adjusted
from tests.engine.synthetic_colmap import camera, write_project
from tests.warm_engine import Process

KILLED = 9  # the exit status of a process of `killed_everywhere`
CHANGES = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.link", "os.truncate")
"""What Python calls changes of names in its audit events; `os.replace` is a renaming, too."""
WRITING = os.O_WRONLY | os.O_RDWR
STEPS_BETWEEN_CHECKPOINTS = 7
SEED = 6
SECRET = "s3cr3t-0f-th3-sh3ll"  # in every engine's environment


@dataclass(frozen=True)
class Moment:
    """The n-th moment, from 1, whose name the pattern is found in; which of `FAULTS` comes then."""

    pattern: str
    number: int
    fault: str = "killed"


@dataclass(frozen=True)
class Ended:
    """The end of a process: exit status, -9 when killed; its standard error; its moments."""

    status: int
    errors: str
    moments: list[str]

    @property
    def steps(self) -> int:
        """Training steps begun; an engine that was killed tells of none."""
        return sum(moment.endswith(": step") for moment in self.moments)


def engine(arguments: Sequence[object], at: Moment | None = None) -> Ended:
    """`python -m roigs_engine ARGUMENTS` in a separate process; it has a preset `tiny` besides.

    Args:
        arguments: of the command line.
        at: the moment at which something happens to it.
    """
    texts = [str(argument) for argument in arguments]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = Process(target=_engine, args=(texts, at, folder))
        process.start()
        process.join()
        assert process.exitcode is not None
        moments = folder / "moments"
        return Ended(
            status=process.exitcode,
            errors=(folder / "errors").read_text(encoding="utf-8"),
            moments=json.loads(moments.read_text(encoding="utf-8")) if moments.exists() else [],
        )


def killed_everywhere(
    start: Path, folder: Path, work: Callable[[], object], *, step: int = 1
) -> Iterator[int]:
    """Do some work in a folder, killed before the first change of a name there, the second, ...

    A file opened to write is a change, too. The last time the work ends.

    Args:
        start: the folder is a copy of it each time.
        folder: where the work is done; it is replaced.
        work: a function of a module, or a partial of one; it gets to a separate process.
        step: only before every so many changes.

    Yields:
        How many changes were begun, each time that the folder may be looked at.
    """
    for number in count(1, step):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(start, folder)
        process = Process(target=_dying, args=(number, str(folder), work))
        process.start()
        process.join()
        assert process.exitcode in (0, KILLED), "it failed by itself"
        yield number
        if process.exitcode == 0:
            return


def _dying(number: int, folder: str, work: Callable[[], object]) -> None:
    """In a separate process, as an audit hook stays."""
    left = number

    def watch(event: str, values: tuple[Any, ...]) -> None:
        nonlocal left
        changes = event in CHANGES or (event == "open" and values[2] & WRITING)
        if changes and isinstance(values[0], str | Path) and str(values[0]).startswith(folder):
            left -= 1
            if left == 0:
                os._exit(KILLED)  # nothing is cleaned up

    sys.addaudithook(watch)
    work()


def tree(folder: Path) -> dict[str, bytes | None]:
    """Path below a folder -> content, None for folders; without files that are written."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
        if not files.LEFTOVER.fullmatch(path.name)
    }


def tiny() -> RunConfig:
    """The paper's strategy in 18 steps and 24, with densification and averaging in both."""
    paper = presets.preset("paper")
    quick = {"start": 4, "every": 4, "until": 13, "grad_threshold": 1e-6}
    density = DensityControl(reset_every=9, **quick)
    roi = adjusted(paper.roi, DensityControl, **quick).using(ModelAveraging(steps=10))
    return replace(
        paper,
        preset="tiny",
        scene=TrainConfig(steps=18, sh_every=5, mechanisms=(density,)),
        roi=replace(roi, steps=24, sh_every=5),
        selection=replace(paper.selection, count=5),
        test_every=4,
    )


class Request:
    """A scene with lens distortion, and what a run that nobody killed has made of it.

    Tests share it: they only read `whole`.
    """

    def __init__(self, folder: Path) -> None:
        """Of a folder that `make` has filled."""
        self._scene, self.whole = folder / "scene", folder / "whole"
        moments = json.loads((folder / "moments.json").read_text(encoding="utf-8"))
        self.moments, self.steps = moments, Ended(0, "", moments).steps

    @classmethod
    def make(cls, folder: Path) -> None:
        """Write the scene, run it, and note the run's moments."""
        lens = camera("OPENCV", params=[100.0, 90.0, 45.0, 40.0, 0.05, 0.01, 0.001, 0.002])
        names = [f"{k}.png" for k in range(10)]
        write_project(folder / "scene", names=names, cameras=[lens], dots=True)
        (folder / "moments.json").write_text("[]", encoding="utf-8")
        request = cls(folder)
        ended = engine(request.arguments(request.whole))
        assert ended.status == 0, ended.errors
        (folder / "moments.json").write_text(json.dumps(ended.moments), encoding="utf-8")

    def arguments(self, run: Path, threads: int = 2) -> list[object]:
        """Of the command line."""
        box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
        request = ["run", self._scene, "--roi", box, "--preset", "tiny"]
        return [*request, "--run-dir", run, "--threads", threads]

    def moment(self, place: str, fault: str = "killed") -> Moment:
        """One of the moments at a place, drawn from the seed."""
        number = sum(bool(re.search(place, name)) for name in self.moments)
        assert number, f"nothing happens at '{place}'"
        return Moment(place, random.Random(f"{SEED} {place}").randint(1, number), fault)

    def finish(self, run: Path) -> Ended:
        """Go on with a run to its end, and compare it with the whole one."""
        ended = engine(self.arguments(run))
        assert ended.status == 0, ended.errors
        assert contents(run) == contents(self.whole)
        for line in (run / "events.jsonl").read_text(encoding="utf-8").splitlines():
            assert json.loads(line)
        return ended


def contents(run: Path) -> dict[str, Any]:
    """File -> bytes, without what tells of times: the log, and seconds in the reports."""
    files = {str(p.relative_to(run)): p.read_bytes() for p in run.rglob("*") if p.is_file()}
    for name in ("events.jsonl", "report.md", "report.html", "provenance.json"):
        del files[name]
    return {
        name: timeless(json.loads(data)) if name.endswith(".json") else data
        for name, data in files.items()
    }


def timeless(value: Any) -> Any:
    """JSON without what was measured by the clock."""
    if isinstance(value, dict):
        return {
            k: timeless(v)
            for k, v in value.items()
            if k not in ("seconds", "cpu_seconds", "stages", "checksum")
        }
    return [timeless(item) for item in value] if isinstance(value, list) else value


def _engine(arguments: list[str], at: Moment | None, folder: Path) -> None:
    """In a separate process."""
    if hasattr(signal, "SIGHUP"):  # `nohup` would have every process below it ignore that
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.modules["tqdm"] = None  # type: ignore[assignment] # its semaphores would outlive a kill
    os.environ["SOME_TOKEN"] = SECRET
    presets.PRESETS["tiny"] = tiny
    kind = options_of(Train)["preset"].kind
    object.__setattr__(kind, "words", (*PRESETS, "tiny"))
    build_parser.cache_clear()  # the server has built it
    clock = _Clock(at)
    stage_folder.PeriodicCallback = functools.partial(_EverySoManySteps, clock)  # type: ignore[misc, assignment]
    _before(trainer.Trainer, "train_step", lambda *_: clock.tick("step"))
    _before(trainer.Trainer, "apply", lambda *_: clock.tick("edit"))
    _before(Console, "should_stop", lambda *_: clock.tick("check"))
    _before(Console, "emit", lambda _, event: clock.watch(event))
    files.open = clock.open  # type: ignore[attr-defined]
    rename = os.replace
    files.os = _OS(clock, rename)  # type: ignore[assignment]
    if at is not None and at.fault in WITH_EVENTS:
        arguments = [*arguments, "--events"]

    def work(stop: StopRequest) -> int:
        status = cli.main(arguments, stop)
        (folder / "half").write_text(json.dumps(clock.names), encoding="utf-8")
        (folder / "half").rename(folder / "moments")  # a further Ctrl-C may end this, too
        return status

    connect(folder / "errors")
    run_process(work)


class _Clock:
    """Counts moments, and has something happen at one of them."""

    def __init__(self, at: Moment | None) -> None:
        self.names: list[str] = []
        self._at, self._stage, self._found = at, "load", 0

    def tick(self, what: str) -> None:
        name = f"{self._stage}: {what}"
        self.names.append(name)
        if self._at is None or not re.search(self._at.pattern, name):
            return
        self._found += 1
        if self._found == self._at.number:
            FAULTS[self._at.fault]()

    def watch(self, event: Any) -> None:
        self._stage = getattr(event, "stage", self._stage)

    def open(self, path: Any, mode: str = "r", **options: Any) -> Any:
        """Files that `files` opens for writing are written in halves."""
        if mode != "wb":
            return open(path, mode, **options)
        clock, name = self, Path(path).name.split(".")[1]

        class Halves(io.BufferedWriter):
            def write(self, data: Any) -> int:
                data = memoryview(data).cast("B")
                super().write(data[: len(data) // 2])
                self.flush()
                clock.tick(f"half of {name}")
                super().write(data[len(data) // 2 :])
                return len(data)

        return Halves(io.FileIO(path, "w"))


class _OS:
    """The module `os`, its renaming between two moments."""

    def __init__(self, clock: _Clock, rename: Callable[[Any, Any], None]) -> None:
        self._clock, self._rename = clock, rename

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def replace(self, source: Path, target: Path) -> None:
        self._clock.tick(f"before {target.name} has its name")
        self._rename(source, target)
        self._clock.tick(f"after {target.name} has its name")


class _EverySoManySteps:
    """In place of the periodic callbacks, which go by the clock."""

    def __init__(self, clock: _Clock, every: float, do: Callable[[], None]) -> None:
        self._due, self._do, self._steps = every > 0, do, 0

    def call_if_due(self, seconds: float) -> float:
        self._steps += 1
        if self._due and self._steps % STEPS_BETWEEN_CHECKPOINTS == 0:
            self._do()
        return 0.0


def _before(owner: type, name: str, do: Callable[..., None]) -> None:
    """Have `do` called before a method."""
    method = getattr(owner, name)

    def both(*args: Any, **options: Any) -> Any:
        do(*args)
        return method(*args, **options)

    setattr(owner, name, both)
