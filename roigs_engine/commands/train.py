"""`train`: the Scene-GS and the box stage, without baselines and evaluation."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..formats import run_files
from ..formats.files import refuse_linked_folders, remove_leftovers, write_json
from ..formats.projects import model_folders
from ..selection.manual import load_manual
from .automatic import (
    box_names,
    boxes_of,
    check_photos,
    is_auto,
    keep_box,
    photos_plan,
    project_of,
    reconstructed,
)
from .console import Console
from .layout_options import add_layout_options, with_layout
from .options import (
    add_device_option,
    add_evaluation_option,
    add_object_mask_option,
    add_roi_options,
    add_scene_options,
    add_selection_options,
    add_training_options,
    boxes,
    context_on_device,
    load_scene,
    mask_options,
    run_config,
)
from .options_file import settings
from .out_folder import refuse_inputs, refuse_run_files
from .values import NAME as TEXT
from .values import PATH, Number, integer

if TYPE_CHECKING:
    from ..model.roi import OrientedBox
    from ..model.scene import SfmScene
    from ..photos.mask_paths import MaskOptions
    from ..run.definition import Run

MAX_SECONDS = 1e9
MOST_LEVELS = 8
MAX_MEGABYTES = 1e9
NAME = "train"
HELP = "train the scene and its boxes, and write one PLY"
EXAMPLES = """\
  python -m roigs_engine train garden --rois garden/rois.json --run-dir runs/garden
  python -m roigs_engine train garden --rois garden/rois.json --run-dir runs/garden --dry-run
  python -m roigs_engine train garden --rois garden/rois.json --run-dir runs/paper --preset paper"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command; `run` has them too."""
    add_scene_options(parser)
    add_object_mask_option(parser)
    add_roi_options(parser)
    add_selection_options(parser)
    add_training_options(parser)
    add_evaluation_option(parser)
    add_layout_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--run-dir", type=PATH, required=True, metavar="DIR", help="folder of the run"
    )
    parser.add_argument(
        "--selection",
        type=PATH,
        metavar="DIR",
        help="folder of ROI.json files with the photos of each box, as `select --out` writes them;"
        " --method selects the photos of boxes without a file",
    )
    parser.add_argument(
        "--levels",
        type=integer(2, MOST_LEVELS),
        metavar="N",
        help="make the result's levels of detail at the end, as `levels` does: N of them",
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="reuse a run folder of other settings: results that still fit are kept, the others"
        " move to its folder 'archive'",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print the plan (stages, photos, steps, memory, minutes) and train nothing",
    )
    parser.add_argument(
        "--preview-seconds",
        type=Number(low=0, high=MAX_SECONDS),
        default=0.0,
        metavar="S",
        help="write the model in training to preview.ply, at most every S seconds; 0: never",
    )
    parser.add_argument(
        "--image-cache",
        type=Number(low=0, high=MAX_MEGABYTES),
        metavar="MB",
        help="megabytes of decoded photos to keep in memory (default: a quarter of the memory)",
    )
    parser.add_argument(
        "--cluster",
        type=TEXT,
        metavar="ADDRESS",
        help="train on a Ray cluster: ray://HOST:10001, auto (the cluster that this machine is part"
        " of), or local (a Ray of this machine alone)",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train, or resume the run in the folder."""
    if args.dry_run:
        return show_plan(args, console)
    from ..run.folder import train_opened

    with opened_run(args, console) as (run, context):
        train_opened(run, (), context, update=args.update, preview_seconds=args.preview_seconds)
        levels_of(run, args, context)
    return places(args, console)


def places(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Where everything is; said."""
    result = args.run_dir / run_files.RESULT
    console.context.info(f"The result is {result}.")
    return {"result": str(result), "rois": str(args.run_dir / run_files.FINE)}


def levels_of(run: Run, args: argparse.Namespace, context: Context) -> None:
    """Make the levels of a trained run, if they are asked for."""
    from ..levels.make import make_levels

    if args.levels:
        images = run.scene.images
        make_levels(run.folder, images, run.frame, levels=args.levels, context=context)


@contextmanager
def opened_run(args: argparse.Namespace, console: Console) -> Iterator[tuple[Run, Context]]:
    """The run of the options; its folder is open and locked during the block.

    Events are also written to the folder, once it is known that it may be this run's. The preview
    is deleted at the end: the result is there.
    """
    from ..colmap.undistorted_photos import remove_unused
    from ..run.definition import define_run
    from ..run.folder import open_folder
    from ..run.manifest import check_version, refuse_other_run
    from ..run.provenance import recorded
    from ..run.side_by_side import PATIENCE, held

    console.log_later()
    photos, inputs = check_photos(args), _early_inputs(args)
    with held(args.run_dir, console.context, PATIENCE if getattr(args, "part", None) else 0):
        refuse_linked_folders(args.run_dir)
        check_version(args.run_dir)
        remove_leftovers(args.run_dir)
        if photos:
            if not (args.run_dir / run_files.MANIFEST).exists():
                console.log_to(args.run_dir)
            reconstructed(args, console)
        context = _context(args, console)
        quiet = replace(context, emit=QUIET.emit)

        def check(cameras: SfmScene) -> None:
            """What is wrong with the options is said before minutes go into the photos."""
            if is_auto(args):
                inputs.update(_inputs(args, boxes_of(args, cameras, args.run_dir)))
            without_pixels = define_run(args.run_dir, cameras, context=quiet, **inputs)
            if not args.update:
                refuse_other_run(args.run_dir, without_pixels.manifest())
            keep_box(args, inputs["rois"], args.run_dir, context)
            console.log_to(args.run_dir)

        # Damaged photos are found only now: without them, other photos may be test photos.
        cache, masks = args.run_dir / run_files.CACHE, _mask_options(args)
        scene = load_scene(args, console, cache, check=check, masks=masks)
        run = define_run(args.run_dir, scene, context=context, **inputs)
        open_folder(run, context, update=args.update)
        write_json(args.run_dir / run_files.SETTINGS, settings(args))
        remove_unused(args.run_dir / run_files.CACHE, scene.images)
        for message in run.memory(context).messages():
            console.emit(message)
        with recorded(args.run_dir, run.config.seed, context.device):
            yield run, context
        with suppress(OSError):  # on Windows, while it is read
            (args.run_dir / run_files.PREVIEW).unlink()


def show_plan(
    args: argparse.Namespace, console: Console, compare: Sequence[str] = ()
) -> dict[str, str]:
    """Print the plan of the run; a few steps are trained to measure time, nothing is written."""
    from ..run.dry_run import describe_plan

    run, context = defined_run(args, console)
    if run is None:
        console.print(photos_plan(args))
    else:
        console.print(describe_plan(run, compare, context, update=args.update))
    return {}


def defined_run(args: argparse.Namespace, console: Console) -> tuple[Run | None, Context]:
    """The run of the options by its cameras alone; nothing is written.

    The run is None if its scene is photos, which have no model yet.
    """
    from ..photos.contents import FILE as CONTENTS
    from ..run.definition import define_run

    if check_photos(args):
        if not model_folders(project_of(args)):
            return None, console.context
        args.scene = project_of(args)
    inputs = _early_inputs(args)
    context = _context(args, console)
    # What is in the photos matters only if there are results to compare them with.
    cache = args.run_dir / run_files.CACHE
    cache = cache if (cache / CONTENTS).exists() else None
    scene = load_scene(args, console, cache, pixels=False, masks=_mask_options(args))
    inputs = inputs or _inputs(args, boxes_of(args, scene, args.run_dir))
    return define_run(args.run_dir, scene, context=context, **inputs), context


def prepared_run(args: argparse.Namespace, console: Console) -> tuple[Run, Context]:
    """The run of a folder that an engine has opened before; the folder is not opened again."""
    from ..run.definition import define_run

    if check_photos(args):
        args.scene = project_of(args)
    inputs, context = _early_inputs(args), _context(args, console)
    cache, masks = args.run_dir / run_files.CACHE, _mask_options(args)
    scene = load_scene(args, console, cache, masks=masks)
    inputs = inputs or _inputs(args, boxes_of(args, scene, args.run_dir))
    return define_run(args.run_dir, scene, context=context, **inputs), context


def _early_inputs(args: argparse.Namespace) -> dict[str, Any]:
    """`_inputs`, as far as the options alone tell them: nothing with `--roi auto`."""
    refuse_run_files(args.run_dir, option="--run-dir")
    run_config(args)
    return {} if is_auto(args) else _inputs(args, boxes(args))


def _inputs(args: argparse.Namespace, rois: Sequence[OrientedBox]) -> dict[str, Any]:
    """Boxes, settings and manual photos for `define_run`."""
    config = with_layout(run_config(args), args, [roi.name for roi in rois])
    if args.selection:
        own = (args.run_dir / run_files.SELECTION / f"{roi.name}.json" for roi in rois)
        given = [args.selection / f"{roi.name}.json" for roi in rois]
        refuse_inputs(own, given, "Give a copy of that folder to --selection.")
    manual = load_manual(args.selection, rois) if args.selection else {}
    return {"rois": rois, "config": config, "manual": manual}


def _mask_options(args: argparse.Namespace) -> MaskOptions:
    """The masks of photos and of the boxes' objects."""
    return mask_options(args, box_names(args, args.run_dir), args.run_dir)


def _context(args: argparse.Namespace, console: Console) -> Context:
    """The context of the options."""
    memory = None if args.image_cache is None else int(1e6 * args.image_cache)
    return replace(context_on_device(args, console), photo_memory=memory)
