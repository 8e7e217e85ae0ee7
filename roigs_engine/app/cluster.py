"""Trains one scene on the machines of a cluster, in parts."""

from __future__ import annotations

from ..context import Context
from ..errors import ConfigError, RunFolderError
from ..formats.files import read_bytes, refuse_linked_folders, write_json
from ..formats.lock import locked
from ..formats.run_files import CLUSTER_LOCK, CLUSTER_OPTIONS, REPORT
from ..formats.text import decode_text
from ..requests.declare import plain, settings_of
from ..requests.runs import RETRIES, Train, TrainAndEvaluate
from .batch_plan import plan_row
from .batch_table import Row
from .outputs import Trained, result_in

KEPT = ("compare", "device", "preview_seconds", "image_cache")
"""Options that are not settings of a run, but that its parts need."""


def train_on_cluster(request: Train, context: Context) -> Trained:
    """Train on the request's cluster; every machine must see its folders.

    The context gets the events of the parts, as if the run were here.

    Raises:
        ConfigError: an option is for a single machine.
        RunFolderError: a part failed.
        Stopped: on request; checkpoints were written.
    """
    from ..batch.board import Reporter
    from ..batch.ray_executor import RayExecutor
    from ..batch.record import BatchRecord
    from ..batch.schedule import Scheduler
    from ..run.manifest import check_version

    if isinstance(request, TrainAndEvaluate) and request.part:
        raise ConfigError("--part is for one machine.", "Leave it out with --cluster.")
    if request.threads:
        raise ConfigError("--threads is for this machine.", "Leave it out with --cluster.")
    assert request.cluster is not None
    row = _row(request)
    folder, options = row.run_dir, row.options_file
    with locked(folder, context.warn, name=CLUSTER_LOCK):
        refuse_linked_folders(folder)
        check_version(folder)
        scene = plan_row(row, BatchRecord(folder), context).scene
        write_json(options, row.options)
        executor = RayExecutor(request.cluster, options, context)
        scheduler = Scheduler(
            [scene], executor, context, retries=RETRIES, told=lambda *told: reporter.take(*told)
        )
        try:
            with Reporter(scheduler.scenes, context, alone=True) as reporter:
                scheduler.run()
        finally:
            executor.close()
    if reason := scheduler.scenes[scene.name].reason:
        raise RunFolderError(reason, "The same command tries again, and keeps finished work.")
    if isinstance(request, TrainAndEvaluate):
        return result_in(folder, decode_text(read_bytes(folder / REPORT)))
    found = result_in(folder, None)
    context.info(f"The result is {found.result}.")
    return found


def _row(request: Train) -> Row:
    """Return the run as a row of a batch; messages about failures show its folder's name."""
    kept = {key: plain(getattr(request, key)) for key in KEPT if hasattr(request, key)}
    kept = {key: value for key, value in kept.items() if value is not None}
    home = request.run_dir.absolute()
    return Row(
        name=home.name,
        line=1,
        options=settings_of(request) | kept,
        run_dir=home,
        options_file=home / CLUSTER_OPTIONS,
        kind=type(request),
        elsewhere=True,
        update=request.update,
    )
