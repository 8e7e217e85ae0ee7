"""An engine that dies at a chosen moment: killed by itself, with SIGKILL, where a test wants it.

A moment is a training step, an edit of the Gaussians, a question whether to stop (between photos,
picks and pictures) or a place within the writing of a file: half written, not yet renamed, just
renamed. It is named after the stage and what goes on: «scene: half of checkpoint».
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import multiprocessing
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from roigs_engine import cli, config, files, trainer
from roigs_engine.commands.console import Console
from roigs_engine.config import RunConfig, TrainConfig

CONTEXT = multiprocessing.get_context("forkserver" if os.name == "posix" else "spawn")
CONTEXT.set_forkserver_preload([__name__, "roigs_engine.pipeline", "roigs_engine.crops"])
STEPS_BETWEEN_CHECKPOINTS = 7


@dataclass(frozen=True)
class Moment:
    """The n-th moment, from 1, whose name the pattern is found in."""

    pattern: str
    number: int


def engine(
    arguments: Sequence[object], kill_at: Moment | None = None, moments: Path | None = None
) -> int:
    """Exit status of `python -m roigs_engine ARGUMENTS`; it knows a preset `tiny` besides.

    Args:
        arguments: of the command line.
        kill_at: the moment at which it is killed (exit status -9).
        moments: where a list of all moments' names goes, as JSON, once it has ended.
    """
    texts = [str(argument) for argument in arguments]
    process = CONTEXT.Process(target=_engine, args=(texts, kill_at, moments))
    process.start()
    process.join()
    assert process.exitcode is not None
    return process.exitcode


def tiny() -> RunConfig:
    """The paper's strategy in 18 steps and 24, with densification and averaging in both."""
    paper = config.preset("paper")
    quick = {"densify_from": 4, "densify_every": 4, "grad_threshold": 1e-6, "sh_every": 5}
    return replace(
        paper,
        preset="tiny",
        scene=TrainConfig(steps=18, densify_until=13, reset_every=9, **quick),
        roi=replace(paper.roi, steps=24, densify_until=13, average_steps=10, **quick),
        selection=replace(paper.selection, count=5),
        test_every=4,
    )


def _engine(arguments: list[str], kill_at: Moment | None, moments: Path | None) -> None:
    """In a process of its own."""
    sys.modules["tqdm"] = None  # type: ignore[assignment] # its semaphores would outlive a kill
    config.PRESETS["tiny"] = tiny
    clock = _Clock(kill_at)
    trainer._Break = functools.partial(_EverySoManySteps, clock)  # type: ignore[misc, assignment]
    _before(trainer.Trainer, "train_step", lambda *_: clock.tick("step"))
    _before(trainer.Trainer, "_apply", lambda *_: clock.tick("edit"))
    _before(Console, "check", lambda *_: clock.tick("check"))
    _before(Console, "emit", lambda _, event: clock.watch(event))
    files.open = clock.open  # type: ignore[attr-defined]
    rename = os.replace
    files.os = _OS(clock, rename)  # type: ignore[assignment]
    with (
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        status = cli.main(arguments)
    if moments is not None:
        moments.write_text(json.dumps(clock.names), encoding="utf-8")
    sys.exit(status)


class _Clock:
    """Counts moments, and kills the process at one of them."""

    def __init__(self, kill_at: Moment | None) -> None:
        self.names: list[str] = []
        self._kill_at, self._stage, self._found = kill_at, "load", 0

    def tick(self, what: str) -> None:
        name = f"{self._stage}: {what}"
        self.names.append(name)
        if self._kill_at is not None and re.search(self._kill_at.pattern, name):
            self._found += 1
            if self._found == self._kill_at.number:
                os.kill(os.getpid(), signal.SIGKILL)

    def watch(self, event: Any) -> None:
        self._stage = getattr(event, "stage", self._stage)

    def open(self, path: Any, mode: str = "r", **options: Any) -> Any:
        """What `files` opens to write is written in halves."""
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
    """In place of the trainer's breaks, which go by the clock."""

    def __init__(self, clock: _Clock, every: float, do: Callable[[], None]) -> None:
        self._due, self._do, self._steps = every > 0, do, 0

    def take_if_due(self, seconds: float) -> float:
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
