"""The plan of a run as text: its stages, photos, steps, memory and minutes."""

from __future__ import annotations

from collections.abc import Sequence

from ..context import QUIET, Context
from ..formats.run_files import MANIFEST
from ..formats.text import counted
from ..kernels import library
from .definition import Run
from .estimate import Estimator, StageEstimate, evaluation_seconds
from .executor import Executor
from .manifest import check_version, from_json, manifest_difference, read_manifest
from .memory import run_memory
from .plan import POINTS, Plan, Stage
from .stage_folder import StageResult
from .strategies import plan_run

HEAD = ("stage", "photos", "size", "steps", "starts from", "Gaussians", "minutes", "")
LEFT = (0, 4, 7)  # columns of text

WORTH_SAYING = 2000  # steps; an estimate takes as long as a few hundred of them


def describe_plan(
    run: Run, compare: Sequence[str] = (), context: Context = QUIET, *, update: bool = False
) -> str:
    """The plan of a run as text; trains a few steps to measure their time, and writes nothing.

    Args:
        run, compare: see `strategies.plan_run`.
        context: gives the device; checked for cancellation.
        update: whether the run would archive other results in its folder.

    Raises:
        As `plan_run`; SceneError: the scene does not fit into the machine's memory;
        RunFolderError: an earlier version made the folder.
    """
    check_version(run.folder)
    memory = run_memory(run, context)
    plan = plan_run(run, compare, context)
    finished = _finished(run, plan, context, update=update)
    rows, seconds, saved = _stage_rows(run, plan, finished, context)
    lines = [*_head(run, plan), "", *_table(rows), ""]
    lines += [message.text for message in memory.messages()]
    lines.append(_time_line(seconds, saved, context))
    return "\n".join([*lines, *_folder_note(run, update=update)])


def expected_time(run: Run, plan: Plan, context: Context, *, update: bool) -> str | None:
    """One line with the minutes that a plan will take; None if that is little or nothing."""
    finished = _finished(run, plan, context, update=update)
    missing = sum(stage.config.steps for stage in plan.stages if finished[stage.name] is None)
    if missing < WORTH_SAYING:
        return None
    _, seconds, saved = _stage_rows(run, plan, finished, context)
    return _time_line(seconds, saved, context)


def _time_line(seconds: float, saved: float, context: Context) -> str:
    threads = counted(library.threads(), "thread") if context.device == "cpu" else context.device
    done = f"; {_minutes(saved)} are already done" if saved else ""
    return f"Time: about {_minutes(seconds)} on this machine ({threads}){done}."


def _head(run: Run, plan: Plan) -> list[str]:
    config, count = run.config, len(run.scene.images)
    lines = [
        f"Plan of {run.folder}: preset {config.preset}, {config.strategy}, seed {config.seed}",
        f"Photos: {count}, {count - len(run.test)} to train on, {len(run.test)} to test on",
    ]
    for folder, selections in plan.selections.items():
        where = f" ({folder})" if folder else ""
        lines += [
            f"Box '{s.roi}'{where}: {counted(len(s.names), 'photo')} selected by {s.method}, of"
            f" {counted(len(s.candidates), 'candidate')}"
            for s in selections
        ]
    return lines


def _finished(
    run: Run, plan: Plan, context: Context, *, update: bool
) -> dict[str, StageResult | None]:
    """Stage -> its result, which is verified, or None."""
    executor = Executor(run, context, update=update)
    return {stage.name: executor.finished(stage) for stage in plan.stages}


def _stage_rows(
    run: Run, plan: Plan, finished: dict[str, StageResult | None], context: Context
) -> tuple[list[tuple[str, ...]], float, float]:
    """A row for each stage; seconds of the missing stages, and of the finished ones."""
    estimator = Estimator(run.train_scene, context)
    ends: dict[str, int] = {}
    estimates: list[StageEstimate] = []
    rows, missing, saved = [], 0.0, 0.0
    for stage in plan.stages:
        start = _start(stage, ends, len(run.train_scene.points))
        done = finished[stage.name]
        if done is None:
            expected = estimator.estimate(stage, start)
            missing += expected.seconds
        else:
            each = done.seconds / max(stage.config.steps, 1)
            expected = StageEstimate(end=done.count, seconds=done.seconds, step_seconds=each)
            saved += done.seconds
        ends[stage.name] = expected.end
        estimates.append(expected)
        rows.append(_row(stage, expected, is_done=done is not None))
    return rows, missing + evaluation_seconds(estimates, len(run.test)), saved


def _start(stage: Stage, ends: dict[str, int], points: int) -> int:
    """The expected number of Gaussians at the start of the stage."""
    if stage.start.kind == POINTS:
        return points
    return max(ends[needed.name] for needed in stage.start.inputs)


def _row(stage: Stage, expected: StageEstimate, *, is_done: bool) -> tuple[str, ...]:
    largest = max((i.camera for i in stage.images), key=lambda c: c.width * c.height)
    count = f"{expected.end:,}" if is_done else f"~{round(expected.end, -3):,}"
    return (
        stage.name,
        str(len(stage.images)),
        f"{largest.width}x{largest.height}",
        f"{stage.config.steps:,}",
        ", ".join(dict.fromkeys(s.name for s in stage.start.inputs)) or "sparse points",
        count,
        f"{expected.seconds / 60:.1f}",
        "done" if is_done else "",
    )


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    cells = [HEAD, *rows]
    widths = [max(len(row[column]) for row in cells) for column in range(len(HEAD))]
    return [
        "  ".join(
            cell.ljust(width) if column in LEFT else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


def _folder_note(run: Run, *, update: bool) -> list[str]:
    """A note if the folder already has another run."""
    path = run.folder / MANIFEST
    if not path.exists():
        return []
    difference = manifest_difference(read_manifest(path), from_json(run.manifest()))
    if not difference:
        return []
    if update:
        return [f"Folder: another run ({difference}) would be archived."]
    return [f"Folder: it has another run ({difference}). Add --update to archive that run."]


def _minutes(seconds: float) -> str:
    if seconds < 90:
        return counted(max(1, round(seconds)), "second")
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.1f} hours"
