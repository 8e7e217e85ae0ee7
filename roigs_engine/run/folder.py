"""Opens a run folder and trains the run in it."""

from __future__ import annotations

from collections.abc import Sequence

from ..context import QUIET, Context
from ..evaluation.views import EvaluatedModel
from ..formats.files import write_json
from ..formats.run_files import SPLIT
from ..model.scene_checks import scene_warnings
from .definition import Run
from .executor import Executor
from .forecast import disk_space, forecast_if_long
from .manifest import claim
from .strategies import plan_run


def open_folder(run: Run, context: Context = QUIET, *, update: bool = False) -> None:
    """Write the manifest and the held-out photos' names to the folder; warn about scene problems.

    Args:
        run: the run; its folder must not be in use (`formats.lock`).
        context: receives the warnings.
        update: accept a folder made for other settings: stages that still fit are kept, the
            results move to `earlier/`.

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
    run: Run,
    compare: Sequence[str] = (),
    context: Context = QUIET,
    *,
    preview_seconds: float = 0.0,
) -> list[EvaluatedModel]:
    """Plan and train a run whose folder is open; returns the models, the run's result last.

    Args:
        run, context: see `open_folder`.
        compare: models to compare with, from `config.COMPARISONS`.
        preview_seconds: seconds of training between two updates of `preview.ply`; 0: none.

    Raises:
        As `plan_run` and `Executor.execute`.
    """
    plan = plan_run(run, compare, context)
    expected = forecast_if_long(run, plan, context)
    if expected is not None:
        context.info(expected.time_line())
        space = disk_space(run, expected)
        if space.level == "warning":
            context.emit(space)
    return Executor(run, context, preview_seconds=preview_seconds).execute(plan)


def train_run(
    run: Run,
    compare: Sequence[str] = (),
    context: Context = QUIET,
    *,
    update: bool = False,
    preview_seconds: float = 0.0,
) -> list[EvaluatedModel]:
    """`open_folder`, then `train_opened`."""
    open_folder(run, context, update=update)
    return train_opened(run, compare, context, preview_seconds=preview_seconds)
