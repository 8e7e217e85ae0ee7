"""Trains the scenes of a table as a batch, several at a time, here or on a cluster."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..batch.parts import WHOLE
from ..context import QUIET, Context
from ..errors import ConfigError, EngineError, RunFolderError
from ..formats.clean_up import is_run_folder
from ..formats.files import own_folder, write_json
from ..formats.lock import locked
from ..formats.run_files import BATCH, BATCH_LOCK, BATCH_OUTPUTS, BATCH_ROWS, REPORT_PAGE
from ..formats.text import counted, duration, in_columns, in_gb
from ..requests.runs import Batch
from .batch_plan import checked_plans, files_of_run, outputs_of, plan_row
from .batch_store import Store, StoredRecord, localized
from .batch_table import Row, Table, write_table
from .outputs import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..batch.engine_process import Outcome
    from ..batch.moves import PartState
    from ..batch.parts import Key, ScenePlan
    from ..batch.record import BatchRecord
    from ..batch.schedule import Executor, SceneState
    from ..formats.events import Record

PAGE_SECONDS = 10.0  # least time between two pages while the batch runs
TABLE = "batch.toml"
MACHINES = (1, 2, 5, 10)
HEAD = ("scene", "objects", "stages", "steps", "memory", "minutes", "")


@dataclass(frozen=True, kw_only=True)
class Batched(Result):
    """The result of a batch: a folder or an address, its page, and the reasons of failures."""

    runs: str
    report: str
    scenes: int  # number of all scenes
    failed: tuple[str, ...] = ()

    @property
    def outputs(self) -> dict[str, str]:
        return {"report": self.report, "runs": self.runs}

    @property
    def error(self) -> EngineError | None:
        if not self.failed:
            return None
        return RunFolderError(
            f"{counted(len(self.failed), 'scene')} of {self.scenes} failed; {self.report} says"
            " why.",
            "The same command tries these again, and keeps finished work.",
        )


def run_batch(request: Batch, context: Context = QUIET) -> Result:
    """Write a table, or show its plan, or run it.

    Raises:
        EngineError: the table or the folder cannot be used.
        Stopped: on request; the same request resumes.
    """
    if request.init:
        table_path = request.table or request.init / TABLE
        count = write_table(table_path, request.init)
        context.info(f"{table_path} has {counted(count, 'scene')}. Check it, then start it.")
        return Result(files={"table": table_path})
    folder, store = _place(request, context)
    assert request.table is not None
    table = Table(request.table, folder)
    chosen = _chosen(table, request.scenes)
    rows, wrong = localized(chosen, store, request.cluster, context)
    table.wrong += wrong
    if request.dry_run:
        return _planned(table, rows, _record(folder, store, rows), context)
    with ExitStack() as stack:
        stack.enter_context(locked(folder, context.warn, name=BATCH_LOCK))
        if store:
            stack.enter_context(store.held(context))
        for name in (BATCH_ROWS, BATCH_OUTPUTS, *(row.name for row in rows)):
            own_folder(folder, name)  # refuses a link
        record = _record(folder, store, rows)
        _refuse_foreign_files(record, rows, store)
        device, scenes = checked_plans(table, rows, record, context)
        record.begin()
        for row in rows:
            write_json(row.options_file, row.options)
        executor = _executor(request, folder, store, device, context)
        try:
            states = _execute(rows, scenes, executor, record, store, request.retries, context)
        finally:
            executor.close()
    runs = store.url if store else str(folder)
    report = f"{runs}/{REPORT_PAGE}" if store else str(folder / REPORT_PAGE)
    failed = tuple(state.reason for state in states if state.reason)
    done = Batched(runs=runs, report=report, scenes=len(states), failed=failed)
    return done.with_places(*(f"failed: {reason}" for reason in failed))


def _place(request: Batch, context: Context) -> tuple[Path, Store | None]:
    """Return the batch's folder here, and its store if any; ConfigError for wrong options."""
    if request.only:
        raise ConfigError(
            "--only chooses boxes, and a batch is of scenes.",
            "Use --scene NAME for one of them; for boxes, write `only` in the table.",
        )
    if request.table is None or request.run_dir is None:
        raise ConfigError(
            "A batch needs TABLE and --run-dir.", "To make a table, use --init FOLDER."
        )
    if request.jobs and request.cluster:
        raise ConfigError("--jobs is for this machine.", "Leave it out with --cluster.")
    if isinstance(request.run_dir, str):
        store = Store(request.run_dir, context)
        return store.folder, store
    if is_run_folder(request.run_dir):
        raise ConfigError(
            f"{request.run_dir} is the folder of one run, whose report a batch would replace.",
            "Choose another --run-dir.",
        )
    return request.run_dir.absolute(), None


def _chosen(table: Table, scenes: Sequence[str]) -> list[Row]:
    """Return the table's rows, or those named by `--scene`; ConfigError for an unknown name."""
    names = [row.name for row in table.rows]
    unknown = [name for name in scenes if name not in names]
    if unknown and not table.wrong:
        hint = f"The scenes are: {', '.join(names)}."
        raise ConfigError(f"There is no scene '{unknown[0]}'.", hint)
    return [row for row in table.rows if not scenes or row.name in scenes]


def _record(folder: Path, store: Store | None, rows: Sequence[Row]) -> BatchRecord:
    """Return the record of earlier batches."""
    from ..batch.record import BatchRecord

    if store is None:
        return BatchRecord(folder)
    store.open(row.name for row in rows)
    return StoredRecord(store)


def _refuse_foreign_files(record: BatchRecord, rows: Sequence[Row], store: Store | None) -> None:
    """Raise ConfigError if the batch would replace files that no batch has written."""
    if record.was_there:
        return
    place, names = str(record.folder), (REPORT_PAGE, BATCH, BATCH_OUTPUTS)
    if store is not None:
        place, found = store.url, store.file_of_others(names, [row.name for row in rows])
    elif any(is_run_folder(row.run_dir) for row in rows):
        return
    else:
        files = (*names, *(f"{BATCH_ROWS}/{row.name}.json" for row in rows))
        found = next((name for name in files if os.path.lexists(record.folder / name)), None)
    if found is not None:
        raise ConfigError(
            f"{place} is not the folder of a batch, which would replace {place}/{found}.",
            "Move its files away, or choose another --run-dir.",
        )


def _executor(
    request: Batch, folder: Path, store: Store | None, device: str, context: Context
) -> Executor:
    from ..batch.local import LocalExecutor, default_jobs

    if request.cluster:
        from ..batch.ray_executor import RayExecutor

        return RayExecutor(request.cluster, None if store else folder / BATCH_LOCK, context)
    return LocalExecutor(request.jobs or default_jobs(device), context)


def _execute(
    rows: Sequence[Row],
    scenes: Sequence[ScenePlan],
    executor: Executor,
    record: BatchRecord,
    store: Store | None,
    retries: int,
    context: Context,
) -> list[SceneState]:
    from ..batch.board import Reporter
    from ..batch.engine_process import DONE, Outcome
    from ..batch.page import write_batch_page
    from ..batch.schedule import Scheduler

    by_name = {row.name: row for row in rows}
    written_at = 0.0

    def told(scene: SceneState, part: PartState, report: Record | Outcome) -> None:
        nonlocal written_at
        if isinstance(report, Outcome) and part.state == DONE:
            try:
                _note(by_name[scene.plan.name], scene, part.part.name, record, store, context)
            except EngineError as error:
                text = f"{scene.plan.name}: {error} The next batch checks this scene again."
                context.warn(text)
        reporter.take(scene, part, report)
        if isinstance(report, Outcome) and time.monotonic() - written_at > PAGE_SECONDS:
            written_at = time.monotonic()
            try:
                write_page()
            except EngineError as error:  # the batch continues
                context.warn(f"The batch's page is out of date. {error}")

    def write_page() -> None:
        is_there = store.is_there if store else None
        write_batch_page(record.folder, scheduler.scenes.values(), is_there)
        if store:
            store.put(BATCH, REPORT_PAGE)

    scheduler = Scheduler(scenes, executor, context, retries=retries, told=told)
    with Reporter(scheduler.scenes, context) as reporter:
        try:
            scheduler.run()
        finally:
            write_page()
    return list(scheduler.scenes.values())


def _note(
    row: Row,
    scene: SceneState,
    part: str,
    record: BatchRecord,
    store: Store | None,
    context: Context,
) -> None:
    """Record the files of a finished part; raises as `BatchRecord.add` does."""
    outputs = {output.name: output for output in outputs_of(row, scene.plan.objects)}
    if part in outputs:
        record.add_output(row.name, outputs[part])
    elif part == WHOLE:
        for name in record.left_over(row.name, outputs.values()):
            context.warn(f"{row.name}: {BATCH_OUTPUTS}/{name} belongs to an earlier result.")
        if store:
            store.fetch(row.name)
        record.add(row.name, row.digest, row.run_dir, files_of_run(row, scene.plan.objects))


# --- plan ---


def _planned(table: Table, rows: Sequence[Row], record: BatchRecord, context: Context) -> Result:
    from ..batch.times import Times

    times = Times()
    _, scenes = checked_plans(table, rows, record, context)
    seconds: dict[Key, float] = {}
    for row in rows:
        context.check_cancelled()
        found = plan_row(row, record, context)
        seconds |= times.of_scene(found.scene, found.run, found.plan, found.context)
    return Result(text=_plan_text(scenes, seconds, times.measured))


def _plan_text(scenes: Sequence[ScenePlan], seconds: Mapping[Key, float], measured: int) -> str:
    """Return a table with a row for each scene, and times for several numbers of machines."""
    from ..batch.times import makespan

    rows = [HEAD, *(_plan_row(scene, seconds) for scene in scenes)]
    objects = sum(len(scene.objects) for scene in scenes)
    parts = [scene.parts for scene in scenes]
    times = ", ".join(f"{count}: {duration(makespan(parts, seconds, count))}" for count in MACHINES)
    unknown = [scene.name for scene in scenes if not scene.steps]
    notes = [
        f"{counted(objects, 'object')} in {counted(len(scenes), 'scene')},"
        f" {counted(sum(map(len, parts)), 'part')}.",
        f"Time on so many machines like this one, an estimate from {counted(measured, 'stage')}"
        f" of which a few steps were trained: {times}.",
    ]
    if unknown:
        notes.append(
            f"Not in it: {counted(len(unknown), 'scene')} of photos without a COLMAP model."
        )
    return "\n".join([*in_columns(rows, left=(0, 6)), "", *notes])


def _plan_row(scene: ScenePlan, seconds: Mapping[Key, float]) -> tuple[str, ...]:
    facts = (
        str(len(scene.steps)),
        f"{sum(scene.steps):,}",
        in_gb(max((part.memory for part in scene.parts), default=0)),
        f"{sum(seconds[part.key] for part in scene.parts) / 60:.1f}",
    )
    return (
        scene.name,
        str(len(scene.objects)),
        *(facts if scene.steps else "????"),
        "done" if scene.done else "" if WHOLE in {p.name for p in scene.parts} else "outputs",
    )
