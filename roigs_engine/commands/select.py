"""`select`: the photos that show each box best, in order; does not need torch."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ..formats.files import write_json
from ..formats.text import counted
from ..model.mask_coverage import with_useful_masks
from ..model.roi import OrientedBox
from ..selection import SelectionConfig, format_selection, select_cameras
from .automatic import box_names, boxes_of, is_auto, keep_box
from .console import Console
from .options import (
    add_object_mask_option,
    add_roi_options,
    add_scene_options,
    add_selection_options,
    boxes,
    load_scene,
    mask_options,
    read_files,
    selection_options,
)
from .out_folder import refuse_inputs
from .values import PATH

HELP = "choose the photos that show each box best"
EXAMPLES = """\
  python -m roigs_engine select garden --rois garden/rois.json
  python -m roigs_engine select garden --roi "vase=0,0,0,1,1,2" --method gp9 --count 40 --out out"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    add_object_mask_option(parser)
    add_roi_options(parser)
    add_selection_options(parser)
    parser.add_argument("--out", type=PATH, metavar="DIR", help="write ROI.json files there")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Select photos for every box; `--test-every` removes test photos first."""
    if not is_auto(args):
        _files(args, boxes(args))  # what is wrong with them is said before the scene is read
    config = replace(SelectionConfig(), **selection_options(args))
    scene = load_scene(args, console, masks=mask_options(args, box_names(args, args.out)))
    rois = boxes_of(args, scene, args.out)
    scene = with_useful_masks(scene, rois, console.context)
    files = _files(args, rois)
    keep_box(args, rois, args.out, console.context)
    tests = None
    if args.test_every is not None:
        from ..selection.split import choose_test_views

        test = choose_test_views(scene, rois, args.test_every, console.context)
        scene, tests = scene.without(set(test)), scene.select(test)
    outputs = {}
    for roi in rois:
        selection = select_cameras(scene, roi, config, console.context, tests=tests)
        console.print(format_selection(selection))
        if args.out:
            write_json(files[roi.name], selection.to_dict())
            outputs[roi.name] = str(files[roi.name])
    if outputs:
        console.print(f"{counted(len(outputs), 'list')} of photos in {args.out}")
    return outputs


def _files(args: argparse.Namespace, rois: list[OrientedBox]) -> dict[str, Path]:
    """Box -> file to write, none of which is an input."""
    files = {roi.name: args.out / f"{roi.name}.json" for roi in rois} if args.out else {}
    refuse_inputs(files.values(), read_files(args))
    return files
