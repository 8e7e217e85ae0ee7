"""Trains, from request to result: run folder, plan, stages, evaluation, levels of detail."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats import run_files
from ..formats.files import refuse_linked_folders, remove_leftovers, write_json
from ..formats.lock import check_held
from ..formats.text import counted
from ..gpu.program import drawing
from ..requests.declare import settings_of
from ..requests.projects import Reconstruct
from ..requests.runs import Train, TrainAndEvaluate
from .asked import Asked
from .event_log import EventLog, logged
from .inputs import count_photos, import_torch, mask_options
from .outputs import Result, Trained, result_in

if TYPE_CHECKING:
    from ..evaluation.views import EvaluatedModel
    from ..model.scene import SfmScene
    from ..run.definition import Run

PREPARE = "prepare"
"""Name of the part of a run that opens the folder and checks the photos."""


def train(request: Train, context: Context = QUIET) -> Trained:
    """Train, or resume the run in the folder; a `TrainAndEvaluate` is also evaluated.

    Raises:
        EngineError: the request, the scene or the folder cannot be used, or training diverged.
        Stopped: on request; the same request resumes.
    """
    import_torch(context)
    from ..run.folder import train_opened

    if request.dry_run or request.cluster:
        raise ConfigError(
            "A training here is neither a dry run nor on a cluster.",
            "Call plan_training or train_on_cluster instead.",
        )
    asked, table = Asked.of(request), None
    if request.surface:
        from ..surface.make import check_packages

        check_packages()
    with logged(context) as (context, log):
        with opened(asked, context, log) as (run, context):
            trained = train_opened(
                run, asked.compare, context, preview_seconds=request.preview_seconds
            )
            if asked.evaluated:
                table = _evaluate(run, trained, context)
            if request.levels:
                from ..levels.make import make_levels

                images = run.scene.images
                make_levels(run.folder, images, run.frame, levels=request.levels, context=context)
            if request.surface:
                from ..surface.make import SurfaceOptions
                from .surface import surfaces_of_run

                surfaces_of_run(run, SurfaceOptions(), context)
        done = result_in(request.run_dir, table)
        if not asked.evaluated:
            context.info(f"The result is {done.result}.")
        log.outputs = done.outputs
    return done


def train_parts(request: TrainAndEvaluate, context: Context = QUIET) -> Trained:
    """Do parts of a run, so that several engines can work in its folder; raises as `train` does.

    The part `prepare` opens the folder and checks the photos; the others are stages.
    """
    from ..run.folder import train_stage
    from ..run.strategies import plan_run

    asked = Asked.of(request)
    stages = [name for name in request.part if name != PREPARE]
    with logged(context) as (context, log):
        if PREPARE in request.part:
            with opened(asked, context, log):
                pass
        if stages:
            run, context = asked.defined(context)
            quiet = replace(context, emit=QUIET.emit)  # `prepare` has emitted the messages
            plan = plan_run(run, asked.compare, quiet)
            for name in stages:
                train_stage(run, plan, name, context)
        done = Trained(files={name: request.run_dir / name for name in stages})
        log.outputs = done.outputs
    return done


# --- plan ---


def plan_training(request: Train, context: Context = QUIET) -> Result:
    """Plan a training; a few steps are trained to measure the time, and nothing is written.

    EngineError: the request, the scene or the folder cannot be used.
    """
    from ..run.dry_run import describe_plan

    asked = Asked.of(request)
    request = asked.request
    if asked.photos is not None and not asked.has_model:
        return Result(text=_plan_of_photos(asked.photos, request))
    run, context = asked.defined(context, pixels=False)
    return Result(text=describe_plan(run, asked.compare, context, update=request.update))


def _plan_of_photos(photos: Path, request: Train) -> str:
    count = counted(count_photos(photos), "photo") if photos.is_dir() else str(photos)
    return "\n".join(
        [
            f"Plan of {request.run_dir}: preset {request.preset}",
            f"1. Make a COLMAP project from {count} in {request.scene}",
            "2. Put a box around the main object of the photos: "
            f"{request.run_dir / run_files.BOXES}",
            "3. Train. For stages, memory and minutes, first run step 1:",
            f"   python -m roigs_engine reconstruct {photos} --out {request.scene}",
        ]
    )


# --- run folder ---


@contextmanager
def opened(asked: Asked, context: Context, log: EventLog) -> Iterator[tuple[Run, Context]]:
    """Open and lock the run's folder during the block; give the run and its context.

    Events are logged to the folder once it is known to be this run's, or free. The preview is
    deleted at the end, when the result exists.
    """
    from ..colmap.undistort import remove_unused
    from ..run.definition import define_run
    from ..run.folder import PATIENCE, held, open_folder
    from ..run.manifest import check_version, refuse_other_run
    from ..run.provenance import recorded

    request, folder = asked.request, asked.request.run_dir
    inputs = asked.inputs(asked.boxes.given)
    with held(folder, context, PATIENCE if asked.parts else 0):
        refuse_linked_folders(folder)
        check_version(folder)
        remove_leftovers(folder)
        if asked.photos is not None:
            if not (folder / run_files.MANIFEST).exists():
                log.open(folder)
            _reconstruct(asked.photos, request, context)
        context = asked.context(context)

        def check(cameras: SfmScene) -> None:
            """Check the options before the photos, which take minutes."""
            if not inputs:
                inputs.update(asked.inputs(asked.boxes.boxes(cameras)))
            quiet = replace(context, emit=QUIET.emit)
            without_pixels = define_run(folder, cameras, context=quiet, **inputs)
            if not request.update:
                refuse_other_run(folder, without_pixels.manifest())
            asked.boxes.keep(inputs["rois"], context)
            log.open(folder)

        # Damaged photos are found only here. Without them, other photos may be test photos.
        scene = asked.scene(context, check=check)
        run = define_run(folder, scene, context=context, **inputs)
        open_folder(run, context, update=request.update)
        if asked.boxes.given is None:
            request = replace(request, rois=asked.boxes.file, roi=())
        write_json(folder / run_files.SETTINGS, settings_of(request))
        remove_unused(folder / run_files.CACHE, scene.images)
        for message in run.memory(context).messages():
            context.emit(message)
        with recorded(folder, run.config.seed, drawing(context.device)):
            yield run, context
        with suppress(OSError):  # on Windows, while another program reads it
            (folder / run_files.PREVIEW).unlink()


def _reconstruct(photos: Path, request: Train, context: Context) -> None:
    """Make the scene's COLMAP project from the photos, or resume it; errors as in `reconstruct`."""
    from ..reconstruction.reconstruct import reconstruct

    context.info(f"{photos} has no COLMAP model; {request.scene} gets one.")
    project = Reconstruct(photos=photos, out=request.scene, threads=request.threads)
    reconstruct(project, mask_options(request), context)


def _evaluate(run: Run, trained: Sequence[EvaluatedModel], context: Context) -> str:
    import torch

    from ..evaluation.evaluate import evaluate
    from .evaluate import write_evaluation

    device = torch.device(context.device)
    models = [model.to(device) for model in trained]
    photos = run.config.evaluate_on
    evaluation = evaluate(models, run.scene, run.measured, run.rois, context=context, photos=photos)
    check_held(run.folder)
    return write_evaluation(evaluation, models, run.scene, run.rois, run.folder, context)
