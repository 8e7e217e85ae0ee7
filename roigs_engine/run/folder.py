"""Works in a run folder, locked by one engine, or by one engine for each stage.

A run holds `run.lock`; an engine that trains one stage holds `STAGE.lock` beside it. Each takes its
own lock first and then checks the other kind, so one of two always sees the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..evaluation.views import EvaluatedModel
from ..formats.files import matching, write_json
from ..formats.lock import holder, is_lock, locked
from ..formats.run_files import LOCK, MANIFEST, SPLIT
from ..model.gaussians import Gaussians
from ..model.scene_checks import scene_warnings
from .definition import Run
from .executor import Executor
from .forecast import disk_space, forecast_if_long
from .manifest import claim, from_json, manifest_difference, read_manifest
from .plan import Plan, Stage
from .strategies import plan_run, plan_surface

PATIENCE = 60.0  # seconds; an engine whose parent was killed still writes a checkpoint
POLL = 0.5
STAGE_LOCKS = "*.lock"


@contextmanager
def held(folder: Path, context: Context, patience: float = 0.0) -> Iterator[None]:
    """Lock a run folder, once no engine trains one of its stages.

    RunFolderError if another engine is still at work there after `patience` seconds.
    """
    with ExitStack() as stack:
        _patiently(lambda: stack.enter_context(locked(folder, context.warn)), context, patience)
        for path in matching(folder, STAGE_LOCKS):
            if path.name != LOCK and is_lock(path):  # other programs have poetry.lock etc.
                _patiently(partial(_refuse_holder, path), context, patience)
                path.unlink(missing_ok=True)  # a killed engine left it
        yield


@contextmanager
def stage_held(folder: Path, stages: tuple[Stage, ...], context: Context) -> Iterator[None]:
    """Lock some stages, once no engine holds the run folder; raises as `held`."""
    with ExitStack() as stack:
        for stage in stages:
            name = f"{stage.name.replace('/', '-')}.lock"

            def hold(name: str = name) -> None:
                stack.enter_context(locked(folder, context.warn, name=name))

            _patiently(hold, context, PATIENCE)
        _patiently(lambda: _refuse_holder(folder / LOCK), context, PATIENCE)
        yield


def open_folder(run: Run, context: Context = QUIET, *, update: bool = False) -> None:
    """Write the manifest and the held-out photos' names to the folder; warn of scene problems.

    Args:
        run: the run; its folder must not be in use (`formats.lock`).
        update: accept a folder made for other settings; valid stages are kept, and the results
            move to `earlier/`.

    Raises:
        RunFolderError: the folder has a run of other settings, or of another version.
        SceneError: the scene does not fit into the machine's memory.
    """
    run.memory(context)
    claim(run.folder, run.manifest(), update=update, context=context)
    write_json(run.folder / SPLIT, run.split())
    for text in scene_warnings(run.train_scene, run.rois):
        context.warn(text)


def train_opened(
    run: Run, compare: Sequence[str] = (), context: Context = QUIET, *, preview_seconds: float = 0.0
) -> list[EvaluatedModel]:
    """Plan and train a run whose folder is open; returns the models, the run's result last.

    `compare` is as in `plan_run`, `preview_seconds` as in `Executor`; raises as these.
    """
    plan = plan_run(run, compare, context)
    expected = forecast_if_long(run, plan, context)
    if expected is not None:
        context.info(expected.time_line())
        context = expected.counting_down(context)
        space = disk_space(run, expected)
        if space.level == "warning":
            context.emit(space)
    return Executor(run, context, preview_seconds=preview_seconds).execute(plan)


def train_stage(run: Run, plan: Plan, name: str, context: Context) -> None:
    """Train one stage of a prepared run folder; missing stages that it starts from come first.

    Raises:
        RunFolderError: the plan has no such stage, the folder is not prepared for this run, or
            another engine is at work there.
        Stopped: on request; a checkpoint was written.
    """
    by_name = {stage.name: stage for stage in plan.stages}
    if name not in by_name:
        raise RunFolderError(
            f"The plan of {run.folder} has no stage '{name}'.",
            f"Its stages are: {', '.join(by_name)}.",
        )
    before = read_manifest(run.folder / MANIFEST)
    difference = manifest_difference(before, from_json(run.manifest()))
    if difference:
        raise RunFolderError(
            f"{run.folder} is prepared for another run ({difference}).",
            "Start again: `batch` prepares it again, and keeps valid stages.",
        )
    executor = Executor(run, context)
    executor.list_stages(plan)
    missing = tuple(s for s in _with_inputs(by_name[name]) if isinstance(executor.status(s), int))
    with stage_held(run.folder, missing or (by_name[name],), context):
        executor.result(by_name[name])
    executor.close()


def train_surface(run: Run, context: Context = QUIET) -> Gaussians | None:
    """Turn the run's result into a surface by the stage `surface`, which is kept.

    The run's folder must be held. None: some of the stages that it starts from are missing.

    Raises:
        Stopped: on request; a checkpoint was written.
        TrainingError: the stage diverged twice.
    """
    plan = plan_surface(run, replace(context, emit=QUIET.emit))  # its messages were already shown
    executor = Executor(run, context)
    *_, result, surface = plan.models
    if any(isinstance(executor.status(stage), int) for stage in result.source.stages):
        return None
    executor.list_stages(plan)
    try:
        return executor.gaussians(surface.source)
    finally:
        executor.close()


def _with_inputs(stage: Stage) -> list[Stage]:
    """The stage and all stages that it needs, in the order of training, each once."""
    found: dict[str, Stage] = {}
    for needed in stage.start.stages:
        found |= {s.name: s for s in _with_inputs(needed)}
    return [*found.values(), stage]


def _patiently(take: Callable[[], None], context: Context, patience: float) -> None:
    """Repeat `take` while another engine is at work; its RunFolderError passes at the end."""
    until = time.monotonic() + patience
    while True:
        try:
            take()
            return
        except RunFolderError as error:
            if not isinstance(error.__cause__, BlockingIOError) or time.monotonic() >= until:
                raise
        context.check_cancelled()
        time.sleep(POLL)


def _refuse_holder(path: Path) -> None:
    process = holder(path)
    if process:
        raise RunFolderError(
            f"Another engine is at work in {path.parent}, process {process}.",
            "Wait for it, or stop it.",
        ) from BlockingIOError()
