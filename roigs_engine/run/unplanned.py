"""Stages that a run has no longer: those of fewer blocks, other groups, another strategy."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from ..context import Context
from ..errors import RunFolderError
from ..formats.files import is_link, matching, own_folder
from ..formats.run_files import CHECKPOINT, STAGE, is_strategy_stage
from ..training.checkpoint import checkpoint_exists, checkpoint_fingerprint
from .archive import DAMAGED, archive
from .definition import Run
from .plan import Plan
from .stage_record import DamagedError, read_record


def archive_unplanned(run: Run, plan: Plan, context: Context) -> None:
    """Move the stages to the archive that the plan has no longer.

    Stages of baselines stay: the next command may compare with them again.

    Args:
        run: whose folder this engine holds.
        plan: of it.
        context: told of what is moved.

    Raises:
        RunFolderError: one cannot be moved.
    """
    planned = {own_folder(run.folder, stage.name) for stage in plan.stages}
    for output in plan.outputs:
        for folder in matching(own_folder(run.folder, output.folder), "*/"):
            if is_strategy_stage(folder.name) and folder not in planned and not is_link(folder):
                _retire(folder)
                name = folder.relative_to(run.folder).as_posix()
                context.info(f"{name}: archived, as the run has no such stage now.")


def _retire(folder: Path) -> None:
    """Archive a stage, finished or not; one that is empty is removed."""
    with suppress(OSError):
        folder.rmdir()
    archive(folder, _fingerprint(folder))


def _fingerprint(folder: Path) -> str:
    """Of the stage in a folder; `DAMAGED`: nothing tells it."""
    with suppress(DamagedError, RunFolderError):
        if record := read_record(folder / STAGE):
            return record.fingerprint
    with suppress(RunFolderError):
        if checkpoint_exists(folder / CHECKPOINT):
            return checkpoint_fingerprint(folder / CHECKPOINT)
    return DAMAGED
