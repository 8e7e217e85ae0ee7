"""`evaluate`: the evaluation table of any PLYs, on test photos."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ..context import Context
from ..errors import ConfigError
from ..formats.files import own_folder, read_json
from ..formats.run_files import CACHE, CROPS, REPORT, REPORT_DATA, REPORT_PAGE, SPLIT
from ..formats.splat_ply import check_ply
from ..formats.text import counted
from ..model.mask_coverage import with_useful_masks
from ..model.scene import SfmScene
from ..run.config import PHOTOS, TEST, VALIDATION, RunConfig
from .console import Console
from .options import (
    add_device_option,
    add_object_mask_option,
    add_roi_options,
    add_scene_options,
    boxes,
    context_on_device,
    load_scene,
    mask_options,
    read_files,
)
from .out_folder import refuse_inputs
from .values import NAME, PATH, integer, named_file

HELP = "compare PLYs on test photos, in each box and on the whole image"
EXAMPLES = """\
  python -m roigs_engine evaluate garden --rois garden/rois.json --out out \\
      --model "Full Scene=runs/garden/full-scene/model.ply" --model Ours=runs/garden/result.ply \\
      --split runs/garden/split.json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    add_object_mask_option(parser)
    add_roi_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--model",
        action="append",
        required=True,
        type=NAME,
        metavar="NAME=FILE.ply",
        help="a row of the table; gains are relative to the first one; repeatable",
    )
    tests = parser.add_mutually_exclusive_group()
    tests.add_argument(
        "--split",
        type=PATH,
        metavar="FILE",
        help="split.json of a run (default: that of the run that the models are from)",
    )
    tests.add_argument(
        "--test-every",
        type=integer(2),
        metavar="N",
        help="test on every N-th photo that sees a box, whether or not a model was trained on it",
    )
    parser.add_argument("--out", type=PATH, required=True, metavar="DIR", help="folder to write to")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Render the test photos with every model, and compare."""
    import torch

    from ..evaluation.crops import write_crops
    from ..evaluation.evaluate import evaluate
    from ..evaluation.report import format_markdown, write_report
    from ..evaluation.report_html import write_page
    from ..evaluation.report_pictures import comparisons
    from ..evaluation.views import EvaluatedModel
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.visibility import check_has_points
    from ..selection.split import choose_test_views

    files = _model_files(args.model)
    reports = (args.out / REPORT, args.out / REPORT_DATA, args.out / REPORT_PAGE)
    refuse_inputs(reports, [*read_files(args), args.split, *files.values()])
    rois, split = boxes(args), args.split
    if split is None and args.test_every is None:
        split = _split_of_run(list(files.values()), console.context)
    photos, test = _split(split) if split else (TEST, [])
    for path in files.values():
        check_ply(path)

    def check(cameras: SfmScene) -> None:
        for roi in rois:
            check_has_points(cameras, roi)
        _check_test_photos(test, split, cameras)

    masks = mask_options(args, [roi.name for roi in rois])
    scene = load_scene(args, console, own_folder(args.out, CACHE), check=check, masks=masks)
    scene = with_useful_masks(scene, rois, console.context)
    wanted = set(test or choose_test_views(scene, rois, args.test_every or RunConfig.test_every))
    test = [image.name for image in scene.images if image.name in wanted]
    if len(test) < len(wanted):
        first = min(wanted - set(test))
        lost = counted(len(wanted) - len(test), f"{photos} photo")
        console.context.warn(f"Left out {lost} that cannot be used, the first is {first}.")
    frame = LocalFrame.of_scene(scene)
    scene, rois = frame.scene(scene), [frame.box(roi) for roi in rois]
    context = context_on_device(args, console)
    models: list[EvaluatedModel] = []
    for name, path in files.items():
        loaded = Gaussians.load_ply(path, frame).to(torch.device(context.device))
        models.append(EvaluatedModel(name=name, gaussians=loaded, seconds=0.0, stages={}))
    evaluation = evaluate(
        models, scene, test, rois, context=context, baseline=models[0].name, photos=photos
    )
    write_report(evaluation, args.out)
    write_crops(evaluation, models, scene, rois, args.out, context=context)
    pictures = comparisons(evaluation, models, scene, rois, context=context)
    write_page(evaluation, pictures, args.out)
    console.print(format_markdown(evaluation))
    places = {"report": REPORT, "page": REPORT_PAGE, "pictures": CROPS}
    outputs = {what: str(args.out / where) for what, where in places.items()}
    console.print_places(outputs)
    return outputs


def _model_files(texts: Sequence[str]) -> dict[str, Path]:
    """Name -> PLY of the options `--model`."""
    files: dict[str, Path] = {}
    for text in texts:
        name, path = named_file("--model", text, "NAME=FILE.ply")
        if name in files:
            raise ConfigError(f"--model names '{name}' twice.", "Give each model its own name.")
        files[name] = path
    return files


def _check_test_photos(test: Sequence[str], split: Path | None, cameras: SfmScene) -> None:
    """Raise ConfigError if the split names photos of another scene, or none that can be used."""
    lost = {name for names in cameras.skipped.values() for name in names}
    unknown = sorted(set(test) - {image.name for image in cameras.images} - lost)
    if unknown:
        raise ConfigError(
            f"{split} names '{unknown[0]}', which is not in the scene.",
            "Use the split.json of a run on this scene.",
        )
    if test and lost.issuperset(test):
        raise ConfigError(
            f"No test photo of {split} can be used, the first is {test[0]}.",
            "Put the photos back, or test on others (--test-every).",
        )


def _split_of_run(models: Sequence[Path], context: Context) -> Path | None:
    """The split of the run that all models are from; None, with a warning, if they are from none.

    A model of a run lies in its folder, or in one or two folders below.
    """
    found = {
        next((p / SPLIT for p in list(path.absolute().parents)[:3] if (p / SPLIT).is_file()), None)
        for path in models
    }
    split = found.pop()
    if split is None or found:
        context.warn(
            "The models may have been trained on photos that they are tested on. Name the"
            " split.json of their run (--split) to test on others."
        )
        return None
    context.info(f"Testing on the photos of {split}.")
    return split


def _split(path: Path) -> tuple[str, list[str]]:
    """Whether a run is evaluated on test or on validation photos, and their names."""
    record = read_json(path, ConfigError, "Use a run's split.json.")
    record = record if isinstance(record, dict) else {}
    photos = record.get("evaluate_on", TEST)
    if photos not in PHOTOS:
        what = f"{path}: 'evaluate_on' is neither {TEST} nor {VALIDATION}."
        raise ConfigError(what, "Use a run's split.json.")
    names = record.get(photos)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        what = f"{path} has no list '{photos}' of photo names."
        raise ConfigError(what, "Use a run's split.json.")
    if not names:
        hint = "Use the split.json of a run with test photos, or --test-every."
        raise ConfigError(f"{path} names no {photos} photo.", hint)
    return photos, names
