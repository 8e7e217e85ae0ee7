"""Options that several commands share, and the values made from them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..colmap.records import MAX_DOWNSCALE, MAX_SIDE
from ..context import Context
from ..errors import ConfigError, RoiError
from ..formats.names import first_taken
from ..formats.run_files import OBJECT_MASKS
from ..formats.text import counted
from ..machine import return_large_blocks
from ..model.roi import OrientedBox, load_rois, parse_roi
from ..model.scene import SfmScene
from ..photos.mask_paths import MaskOptions
from ..run.config import INITS, MAX_FACTOR, ORDERS, PHOTOS, STRATEGIES, RunConfig
from ..run.presets import PRESETS, in_strategy, preset
from ..selection import METHODS
from ..selection.config import MAX_SEED
from .console import Console
from .values import NAME, PATH, Number, integer

MAX_THREADS = 1024
AUTO = "auto"  # the value of --roi for a box around what most photos show
TEST_EVERY = integer(2, zero=True)


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """The scene, and the size of its photos."""
    parser.add_argument(
        "scene",
        type=PATH,
        help="folder with a COLMAP model (sparse/0, sparse, or the model itself), or an options"
        " file (JSON) whose keys are the long names of these options",
    )
    parser.add_argument(
        "--exclude",
        type=NAME,
        action="append",
        default=[],
        metavar="PHOTO",
        help="leave a photo out, by its name in the model; repeatable",
    )
    group = parser.add_argument_group("scene")
    add_size_options(group)
    add_mask_options(group)


def add_size_options(group: argparse._ArgumentGroup) -> None:
    """The photos' folder and size, and the threads."""
    group.add_argument(
        "--images",
        type=PATH,
        metavar="DIR",
        help="folder of the photos (default: images, images_2, images_4 or images_8)",
    )
    size = group.add_mutually_exclusive_group()
    size.add_argument(
        "--downscale",
        type=Number(low=1, high=MAX_DOWNSCALE),
        metavar="N",
        help="divide the photos' size by N",
    )
    size.add_argument(
        "--max-side",
        type=integer(1, MAX_SIDE),
        metavar="PX",
        help="limit the photos' longest side to PX pixels",
    )
    add_threads_option(group)


def add_mask_options(group: argparse._ActionsContainer) -> None:
    """Which parts of the photos are ignored."""
    either = group.add_mutually_exclusive_group()
    either.add_argument(
        "--masks",
        type=PATH,
        metavar="DIR",
        help="folder of masks, 012.jpg.png for the photo 012.jpg: what is black is ignored"
        " (default: the folder masks beside that of the photos, if there is one)",
    )
    # None, not False: what is not given is not in an options file
    either.add_argument(
        "--no-masks",
        action="store_true",
        default=None,
        help="use whole photos: no masks, and no alpha channels",
    )
    group.add_argument(
        "--invert-masks",
        action="store_true",
        default=None,
        help="in the masks' files, black marks what is used",
    )


def add_object_mask_option(parser: argparse.ArgumentParser) -> None:
    """Whether masks of the boxes' objects are used."""
    group = parser.add_argument_group("masks of objects")
    group.add_argument(
        "--no-object-masks",
        action="store_true",
        default=None,
        help="use whole boxes: no masks of their objects (masks/vase/012.jpg.png shows the object"
        " of box vase on the photo 012.jpg; white is the object)",
    )
    group.add_argument(
        "--object-masks",
        type=PATH,
        metavar="DIR",
        help="folder of such masks for photos without one in masks: DIR/vase/012.jpg.png"
        f" (`train` and `run` use {OBJECT_MASKS} of the run folder, where Blender puts them if"
        " it cannot write beside the photos)",
    )


def mask_options(
    args: argparse.Namespace, boxes: Iterable[str] = (), run: Path | None = None
) -> MaskOptions:
    """The options of `add_mask_options` and `add_object_mask_option`, of a command that has them.

    Args:
        args: of the command.
        boxes: names of those whose masks of objects are used, unless `--no-object-masks` is given.
        run: the run folder; its masks of objects are used, unless a folder of masks is given.

    Raises:
        ConfigError: `--object-masks` names no folder.
    """
    folder, objects = getattr(args, "masks", None), getattr(args, "object_masks", None)
    if objects is not None and not objects.is_dir():
        raise ConfigError(f"{objects} is not a folder.", "Give --object-masks the masks' folder.")
    if objects is None and folder is None and run is not None:
        objects = run / OBJECT_MASKS
    return MaskOptions(
        folder=folder,
        objects=objects,
        inverted=bool(getattr(args, "invert_masks", False)),
        used=not getattr(args, "no_masks", False),
        boxes=() if getattr(args, "no_object_masks", False) else tuple(boxes),
    )


def add_threads_option(parser: argparse._ActionsContainer) -> None:
    """The threads of the CPU kernels."""
    parser.add_argument(
        "--threads",
        type=integer(1, MAX_THREADS),
        metavar="N",
        help="CPU threads (default: as many as there are cores)",
    )


def add_roi_options(parser: argparse.ArgumentParser) -> None:
    """The boxes."""
    group = parser.add_argument_group("boxes")
    group.add_argument("--rois", type=PATH, metavar="FILE", help="rois.json with the boxes")
    group.add_argument(
        "--roi",
        type=NAME,
        action="append",
        default=[],
        metavar="NAME=x0,y0,z0,x1,y1,z1",
        help="one box by its corners in the COLMAP frame; repeatable. auto (select, train, run):"
        " a box around what most photos show, written to rois.json",
    )
    group.add_argument(
        "--only",
        "--box",
        type=NAME,
        action="append",
        default=[],
        metavar="NAME",
        help="use only the box of this name; repeatable",
    )


def add_selection_options(parser: argparse.ArgumentParser) -> None:
    """The selection of photos."""
    group = parser.add_argument_group("selection")
    group.add_argument("--method", choices=METHODS, help="how photos are selected")
    group.add_argument(
        "--count", type=integer(1), metavar="K", help="number of photos to select for each box"
    )
    group.add_argument(
        "--seed",
        type=integer(0, MAX_SEED),
        metavar="N",
        help="seed of all random numbers (default: 0)",
    )
    group.add_argument(
        "--test-every",
        type=TEST_EVERY,
        metavar="N",
        help="make every N-th photo that sees a box a test photo; 0: none",
    )


def add_evaluation_option(parser: argparse.ArgumentParser) -> None:
    """Test or validation photos."""
    parser.add_argument(
        "--evaluate-on",
        choices=PHOTOS,
        help="photos to evaluate on: the test photos (default), or validation photos, to choose"
        " settings with; nothing uses the test photos then",
    )


def add_training_options(parser: argparse.ArgumentParser) -> None:
    """The preset, and settings that override it."""
    group = parser.add_argument_group("training")
    group.add_argument(
        "--preset", choices=sorted(PRESETS), default="draft", help="settings (default: draft)"
    )
    group.add_argument(
        "--strategy", choices=STRATEGIES, help="one joint stage for all boxes, or one for each box"
    )
    group.add_argument(
        "--steps-factor",
        type=Number(low=0, high=MAX_FACTOR, above=True),
        metavar="F",
        help="multiply the steps of both stages by F",
    )
    group.add_argument(
        "--kept-share",
        type=Number(low=0, high=1),
        metavar="S",
        help="share of the selected photos, 0 to 1, that the Scene-GS is trained on too",
    )
    group.add_argument(
        "--roi-init",
        choices=INITS,
        help="what the box stage starts from: the Scene-GS, the sparse points, or those of the"
        " Scene-GS's Gaussians that are in the box",
    )
    group.add_argument("--roi-order", choices=ORDERS, help="order of the selected photos")
    group.add_argument(
        "--sh-degree", type=integer(0, 3), metavar="N", help="highest SH degree, 0 to 3"
    )
    group.add_argument(
        "--antialiased",
        action=argparse.BooleanOptionalAction,
        help="draw fine Gaussians fainter from afar, not thicker: sharp near and far, but only in"
        " viewers that know of it (default: on; off in `paper`)",
    )


def add_device_option(parser: argparse.ArgumentParser) -> None:
    """The device that renders and trains."""
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="auto uses an NVIDIA GPU that passes its check, else the CPU (default: %(default)s)",
    )


def context_on_device(args: argparse.Namespace, console: Console) -> Context:
    """The console's context with the device of `add_device_option`; sets up the process for it.

    Raises:
        KernelError: the device is not available.
    """
    from ..cuda.device import choose_device
    from ..training.gpu_check import check_once

    context = console.context
    return_large_blocks()
    return replace(context, device=str(choose_device(args.device, context, check_once)))


def load_scene(
    args: argparse.Namespace,
    console: Console,
    cache: Path | None = None,
    *,
    pixels: bool = True,
    check: Callable[[SfmScene], None] | None = None,
    masks: MaskOptions | None = None,
) -> SfmScene:
    """The scene of `add_scene_options`.

    Args:
        args, console: of the command.
        cache: folder for undistorted photos; None: only cameras are needed, not pixels.
        pixels: False if only cameras, and what `cache` knows of the photos, are needed.
        check: called with the cameras before any photo is decoded.
        masks: which to use; None: those of `mask_options`, without masks of objects.
    """
    from ..colmap.project import load_colmap
    from ..kernels.library import set_threads

    if args.threads is not None:  # else do not load the kernels: they may not run here
        set_threads(args.threads)
    scene = load_colmap(
        args.scene,
        images=args.images,
        cache=cache,
        downscale=args.downscale,
        max_side=args.max_side,
        masks=masks or mask_options(args),
        pixels=pixels and cache is not None,
        check=check,
        context=console.context,
    )
    return _without(scene, getattr(args, "exclude", []), console.context)


def _without(scene: SfmScene, photos: list[str], context: Context) -> SfmScene:
    """The scene without the photos of `--exclude`."""
    there = {image.name for image in scene.images}
    skipped = {name for names in scene.skipped.values() for name in names}
    unknown = [name for name in photos if name not in there | skipped]
    if unknown:
        raise ConfigError(
            f"There is no photo '{unknown[0]}' to exclude.", "Use its name in the COLMAP model."
        )
    excluded = tuple(sorted(there & set(photos)))
    if not excluded:
        return scene
    if len(excluded) == len(there):
        raise ConfigError("--exclude leaves no photo.", "Exclude fewer.")
    context.info(f"Excluded {counted(len(excluded), 'photo')}.")
    return replace(scene.without(excluded), skipped={**scene.skipped, "excluded": excluded})


def read_files(args: argparse.Namespace) -> list[Path | None]:
    """The files that these options name, as far as a command has them."""
    return [getattr(args, name, None) for name in ("options_file", "rois")]


def boxes(args: argparse.Namespace, *, required: bool = True) -> list[OrientedBox]:
    """The boxes of `add_roi_options`.

    Raises:
        RoiError: there is no box, two share a name, or `--only` names an unknown one.
    """
    if AUTO in args.roi:
        raise ConfigError(
            f"--roi {AUTO} is an option of select, train and run.",
            "Give --rois the rois.json that these write.",
        )
    rois = load_rois(args.rois) if args.rois else []
    rois += [parse_roi(text) for text in args.roi]
    taken = first_taken(roi.name for roi in rois)
    if taken is not None:
        raise RoiError(f"Two boxes are named '{taken}'.", "Give each its own name.")
    rois = only(rois, args)
    if required and not rois:
        raise RoiError("There is no box.", "Add --rois FILE or --roi NAME=x0,y0,z0,x1,y1,z1.")
    return rois


def only(rois: list[OrientedBox], args: argparse.Namespace) -> list[OrientedBox]:
    """The boxes that `--only` names, all without it; RoiError if it names an unknown one."""
    names = [roi.name for roi in rois]
    for name in args.only:
        if name not in names:
            hint = f"The boxes are: {', '.join(names)}." if names else "Add --rois or --roi."
            raise RoiError(f"There is no box '{name}'.", hint)
    return [roi for roi in rois if roi.name in args.only] if args.only else rois


def given_options(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """The named options that the user gave, by name."""
    values = {name: getattr(args, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def selection_options(args: argparse.Namespace) -> dict[str, Any]:
    """The options of `add_selection_options` that are fields of `SelectionConfig`."""
    return given_options(args, "method", "count", "seed")


def run_config(args: argparse.Namespace) -> RunConfig:
    """The preset with the options applied."""
    config = preset(args.preset)
    if args.strategy and args.strategy != config.strategy:
        config = replace(in_strategy(config, args.strategy), preset=config.preset)
    if args.steps_factor is not None:
        config = config.scaled(args.steps_factor)
    given = given_options(
        args, "kept_share", "roi_init", "roi_order", "test_every", "seed", "evaluate_on"
    )
    selection = selection_options(args)
    config = replace(config, **given, selection=replace(config.selection, **selection))
    stages = given_options(args, "sh_degree", "antialiased")
    return replace(config, scene=replace(config.scene, **stages), roi=replace(config.roi, **stages))
