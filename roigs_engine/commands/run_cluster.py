"""`run` and `train` with `--cluster`: the parts of one run, on the machines of a cluster."""

from __future__ import annotations

import argparse
import time
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..errors import ConfigError, RunFolderError
from ..formats.files import read_bytes, refuse_linked_folders, write_json
from ..formats.lock import locked
from ..formats.run_files import CLUSTER_LOCK, CLUSTER_OPTIONS, REPORT
from ..formats.text import decode_text
from . import run as run_command
from . import train
from .batch_table import Row
from .console import Console
from .options_file import settings

if TYPE_CHECKING:
    from ..batch.parts import ScenePlan
    from ..batch.schedule import Executor, SceneState

RETRIES = 3  # if a machine or process is lost
KEPT = ("compare", "device", "preview_seconds", "image_cache")
"""Options that are no settings of a run, and that its parts must have."""


def is_asked(args: argparse.Namespace) -> bool:
    """Whether the command line is one that `run` here does."""
    commands = (run_command.NAME, train.NAME)
    return args.command in commands and bool(args.cluster) and not args.dry_run


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Do a run on the cluster that its options name; every machine must see its folders.

    The console gets the events of the parts, as if the run were here.

    Raises:
        RunFolderError: a part failed.
        Stopped: on request; checkpoints were written.
    """
    from ..batch.ray_executor import RayExecutor
    from ..batch.record import BatchRecord
    from .batch_plan import plan_row

    if getattr(args, "part", None):
        raise ConfigError("--part is for one machine.", "Leave it out with --cluster.")
    if args.threads:
        raise ConfigError("--threads is for this machine.", "Leave it out with --cluster.")
    folder = args.run_dir = args.run_dir.absolute()
    row = _row(args)
    with locked(folder, console.context.warn, name=CLUSTER_LOCK):
        refuse_linked_folders(folder)
        scene = plan_row(row, folder, BatchRecord(folder), console).scene
        write_json(folder / CLUSTER_OPTIONS, row.options)
        console.resumes = True
        executor = RayExecutor(args.cluster, folder / CLUSTER_OPTIONS, console.context)
        try:
            state = _execute(args, executor, scene, console)
        finally:
            executor.close()
    if state.reason:
        raise RunFolderError(state.reason, "The same command tries again, and keeps what is done.")
    if args.command == train.NAME:
        return train.places(args, console)
    console.print(decode_text(read_bytes(folder / REPORT)))
    return run_command.places(args, console)


def _row(args: argparse.Namespace) -> Row:
    """The run as a row of a batch; its folder has a name, which the texts of a failure show."""
    row_args = copy(args)
    row_args.cluster = None
    options: dict[str, Any] = settings(args)
    options |= {key: value for key in KEPT if (value := getattr(args, key, None)) is not None}
    name = args.run_dir.name
    row = Row(name=name, line=1, options=options, args=row_args, elsewhere=True)
    return replace(row, command=args.command, home=args.run_dir)


def _execute(
    args: argparse.Namespace, executor: Executor, plan: ScenePlan, console: Console
) -> SceneState:
    from ..batch.board import Board
    from ..batch.schedule import Scheduler
    from .batch_show import Shown

    context = replace(console.context, emit=lambda event: shown.message(event))
    scheduler = Scheduler(
        [plan], executor, context, retries=RETRIES, told=lambda *told: shown.take(*told)
    )
    board = Board(scheduler.scenes, time.monotonic())
    shown = Shown(console, board, json_lines=args.events, alone=True)
    try:
        scheduler.run()
    finally:
        shown.draw(now=True)
    return scheduler.scenes[plan.name]
