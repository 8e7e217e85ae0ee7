"""`batch`: the runs of a table of scenes, side by side, here or on a cluster."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import Context
from ..errors import ConfigError, EngineError, RunFolderError
from ..formats.clean_up import is_run_folder
from ..formats.files import write_json
from ..formats.lock import locked
from ..formats.run_files import BATCH, BATCH_LOCK, BATCH_OUTPUTS, REPORT_PAGE
from ..formats.text import counted
from ..storage.urls import is_url
from .batch_init import write_table
from .batch_outputs import files_of_run, outputs_of
from .batch_plan import checked_plans, options_path, plan_row
from .batch_store import PLACE, Store, StoredRecord, localized
from .batch_table import Row, Table
from .console import Console
from .values import NAME, PATH, integer

if TYPE_CHECKING:
    from ..batch.engine_process import Outcome
    from ..batch.moves import PartState
    from ..batch.parts import ScenePlan
    from ..batch.record import BatchRecord
    from ..batch.schedule import Executor, SceneState
    from ..formats.events import Record

MOST_JOBS, MOST_RETRIES, RETRIES = 1024, 100, 3
PAGE_SECONDS = 10.0  # between two pages while the batch goes on
TABLE = "batch.toml"
HELP = "do the runs of a table of scenes, several at once, here or on a cluster"
EXAMPLES = """\
  python -m roigs_engine batch museum.toml --init scans
  python -m roigs_engine batch museum.toml --run-dir runs/museum --dry-run
  python -m roigs_engine batch museum.toml --run-dir runs/museum --jobs 4
  python -m roigs_engine batch museum.toml --run-dir runs/museum --cluster auto"""


class OnlyIsForBoxes(argparse.Action):
    """Says which option chooses scenes."""

    def __call__(self, *_: object) -> None:
        """Raise a ConfigError."""
        raise ConfigError(
            "--only chooses boxes, and a batch is of scenes.",
            "Use --scene NAME for one of them; for boxes, write `only` in the table.",
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "table",
        type=PATH,
        nargs="?",
        metavar="TABLE",
        help="TOML file with the scenes and their settings (docs/many.md)",
    )
    parser.add_argument(
        "--init", type=PATH, metavar="FOLDER", help="write TABLE with the scenes of this folder"
    )
    parser.add_argument(
        "--run-dir",
        type=PLACE,
        metavar="DIR",
        help="folder that gets a run folder for each scene; also an address such as s3://BUCKET/RUNS",
    )
    parser.add_argument(
        "--scene",
        dest="scenes",
        type=NAME,
        action="append",
        default=[],
        metavar="NAME",
        help="do the scene of this name only; repeatable",
    )
    parser.add_argument("--only", type=NAME, action=OnlyIsForBoxes, help=argparse.SUPPRESS)
    parser.add_argument(
        "--jobs",
        type=integer(1, MOST_JOBS),
        metavar="N",
        help="most parts at a time on this machine (default: one for every two cores)",
    )
    parser.add_argument(
        "--cluster",
        type=NAME,
        metavar="ADDRESS",
        help="do the parts on Ray: ray://HOST:10001, auto (the cluster that this machine is part"
        " of), or local (a Ray of this machine alone)",
    )
    parser.add_argument(
        "--retries",
        type=integer(0, MOST_RETRIES, zero=True),
        default=RETRIES,
        metavar="N",
        help=f"how often a part is tried again if its process is lost (default: {RETRIES})",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="check the table, print its plan (stages, steps, memory, time), and do nothing",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Write a table, print its plan, or do it."""
    if args.init:
        table = args.table or args.init / TABLE
        count = write_table(table, args.init)
        console.context.info(f"{table} has {counted(count, 'scene')}. Look at it, then start it.")
        return {"table": str(table)}
    if args.table is None or args.run_dir is None:
        raise ConfigError(
            "A batch needs TABLE and --run-dir.", "To make a table, use --init FOLDER."
        )
    if args.jobs and args.cluster:
        raise ConfigError("--jobs is for this machine.", "Leave it out with --cluster.")
    if isinstance(args.run_dir, Path) and is_run_folder(args.run_dir):
        raise ConfigError(
            f"{args.run_dir} is the folder of one run, whose report a batch would replace.",
            "Choose another --run-dir.",
        )
    store = args.store = Store(args.run_dir) if isinstance(args.run_dir, str) else None
    folder = args.run_dir = store.folder if store else args.run_dir.absolute()
    table = Table(args.table)
    rows, wrong = localized(_chosen(table, args.scenes), store, args, console.context)
    table.wrong += wrong
    if args.dry_run:
        return _show(table, rows, _record(args, rows), console)
    with ExitStack() as stack:
        stack.enter_context(locked(folder, console.context.warn, name=BATCH_LOCK))
        if store:
            stack.enter_context(store.held(console.context))
        record = _record(args, rows)
        device, scenes = checked_plans(table, rows, folder, record, console)
        for row in rows:
            write_json(options_path(row, folder), row.options)
        executor = _executor(args, device, console.context)
        try:
            states = _execute(args, executor, scenes, rows, record, console)
        finally:
            executor.close()
    return _finish(store.url if store else str(folder), states, console)


def _chosen(table: Table, scenes: list[str]) -> list[Row]:
    """The table's rows, or those that `--scene` names; ConfigError if it names another."""
    names = [row.name for row in table.rows]
    unknown = [name for name in scenes if name not in names]
    if unknown and not table.wrong:
        hint = f"The scenes are: {', '.join(names)}."
        raise ConfigError(f"There is no scene '{unknown[0]}'.", hint)
    return [row for row in table.rows if not scenes or row.name in scenes]


def _record(args: argparse.Namespace, rows: Sequence[Row]) -> BatchRecord:
    """What earlier batches have done."""
    from ..batch.record import BatchRecord

    if args.store is None:
        return BatchRecord(args.run_dir)
    args.store.open(row.name for row in rows)
    return StoredRecord(args.store)


def _show(table: Table, rows: list[Row], record: BatchRecord, console: Console) -> dict[str, str]:
    """Print the plan; the time of a step is measured, nothing is written."""
    from ..batch.times import Times
    from .batch_show import plan_text

    folder, times = record.folder, Times()
    _, scenes = checked_plans(table, rows, folder, record, console)
    seconds: dict[tuple[str, str], float] = {}
    for row in rows:
        console.context.check_cancelled()
        found = plan_row(row, folder, record, console)
        seconds |= times.of_scene(found.scene, found.run, found.plan, found.context)
    console.print(plan_text(scenes, seconds, times.measured))
    return {}


def _executor(args: argparse.Namespace, device: str, context: Context) -> Executor:
    """Where the parts are done."""
    from ..batch.local import LocalExecutor, default_jobs

    if args.cluster:
        from ..batch.ray_executor import RayExecutor

        sign = None if args.store else args.run_dir / BATCH_LOCK
        return RayExecutor(args.cluster, sign, context)
    return LocalExecutor(args.jobs or default_jobs(device), context)


def _execute(
    args: argparse.Namespace,
    executor: Executor,
    scenes: Sequence[ScenePlan],
    rows: Sequence[Row],
    record: BatchRecord,
    console: Console,
) -> list[SceneState]:
    """Do all parts; the page and the record are written as scenes end."""
    from ..batch.board import Board
    from ..batch.engine_process import DONE, Outcome
    from ..batch.page import write_batch_page
    from ..batch.schedule import Scheduler
    from .batch_show import Shown

    folder, by_name = args.run_dir, {row.name: row for row in rows}
    written_at = 0.0

    def told(scene: SceneState, part: PartState, report: Record | Outcome) -> None:
        nonlocal written_at
        if isinstance(report, Outcome) and part.state == DONE:
            row = by_name[scene.plan.name]
            try:
                _note(args, record, row, scene, part, context)
            except EngineError as error:
                context.warn(f"{row.name}: {error} The next batch looks at this scene again.")
        shown.take(scene, part, report)
        if isinstance(report, Outcome) and time.monotonic() - written_at > PAGE_SECONDS:
            show_page()
            written_at = time.monotonic()

    def show_page() -> None:
        is_there = args.store.is_there if args.store else None
        write_batch_page(folder, scheduler.scenes.values(), is_there)
        if args.store:
            args.store.put(BATCH, REPORT_PAGE)

    context = replace(console.context, emit=lambda event: shown.message(event))
    scheduler = Scheduler(scenes, executor, context, retries=args.retries, told=told)
    console.resumes = True
    board = Board(scheduler.scenes, time.monotonic())
    shown = Shown(console, board, json_lines=args.events)
    console.context.info(f"{board.head()}.")
    try:
        scheduler.run()
    finally:
        shown.draw(now=True)
        show_page()
    return list(scheduler.scenes.values())


def _note(
    args: argparse.Namespace,
    record: BatchRecord,
    row: Row,
    scene: SceneState,
    part: PartState,
    context: Context,
) -> None:
    """Write down what a part has finished; raises as `BatchRecord.add`."""
    from ..batch.parts import WHOLE

    folder, objects = args.run_dir, scene.plan.objects
    outputs = {output.name: output for output in outputs_of(row, folder, objects)}
    if part.part.name in outputs:
        record.add_output(row.name, outputs[part.part.name])
    elif part.part.name == WHOLE:
        for name in record.left_over(row.name, outputs.values()):
            context.warn(f"{row.name}: {BATCH_OUTPUTS}/{name} is of an earlier result.")
        if args.store:
            args.store.fetch(row.name)
        record.add(row.name, row.digest, folder / row.name, files_of_run(row, folder, objects))


def _finish(where: str, states: Sequence[SceneState], console: Console) -> dict[str, str]:
    """Say how it ended.

    Raises:
        RunFolderError: a scene failed.
    """
    failed = [state for state in states if state.reason]
    page = f"{where}/{REPORT_PAGE}" if is_url(where) else str(Path(where, REPORT_PAGE))
    for state in failed:
        console.print(f"failed: {state.reason}")
    console.print_places({"report": page, "runs": where})
    if failed:
        raise RunFolderError(
            f"{counted(len(failed), 'scene')} of {len(states)} failed; {page} says why.",
            "The same command tries these again, and keeps what is done.",
        )
    return {"report": page, "runs": where}
