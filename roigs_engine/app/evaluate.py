"""Evaluates any PLYs on test photos: scores, tables, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder, read_json
from ..formats.others import first_other
from ..formats.run_files import CACHE, REPORT, REPORT_DATA, REPORT_PAGE, SPLIT, STAGES
from ..formats.splat_ply import check_ply
from ..formats.stage_list import read_stage_list
from ..formats.text import counted
from ..model.mask_coverage import with_useful_masks
from ..model.scene import SfmScene
from ..requests.choices import PHOTOS, TEST, VALIDATION
from ..requests.runs import Evaluate
from ..run.config import RunConfig
from ..run.manifest import CACHED
from .inputs import boxes_of, load_model, load_scene, mask_options, on_device
from .outputs import Evaluated, named_files, refuse_inputs, refuse_run_files
from .surface_record import add_to_reports

if TYPE_CHECKING:
    from ..evaluation.scores import Evaluation
    from ..evaluation.views import EvaluatedModel
    from ..model.roi import OrientedBox

SPLIT_HINT = "Use a run's split.json."


def evaluate(request: Evaluate, context: Context = QUIET) -> Evaluated:
    """Render the test photos with every model, and compare; EngineError for wrong input."""

    from ..evaluation import evaluate as evaluation_module
    from ..evaluation.views import EvaluatedModel
    from ..model.local_frame import LocalFrame
    from ..model.visibility import check_has_points
    from ..selection.split import choose_test_views

    refuse_run_files(request.out)
    files = named_files("--model", request.model, "NAME=FILE.ply")
    reports = [request.out / name for name in (REPORT, REPORT_DATA, REPORT_PAGE)]
    given = (request.options_file, request.rois, request.split)
    refuse_inputs(reports, [*given, *files.values()])
    rois, split = boxes_of(request), request.split
    if split is None and request.test_every is None:
        split = _split_of_run(list(files.values()), context)
    photos, test = _read_split(split) if split else (TEST, [])
    for path in files.values():
        check_ply(path)

    def check(cameras: SfmScene) -> None:
        for roi in rois:
            check_has_points(cameras, roi)
        _check_test_photos(test, split, cameras)

    masks = mask_options(request, [roi.name for roi in rois])
    if (other := first_other(request.out, CACHED)) is not None:
        raise ConfigError(f"{other} would be replaced.", "Move it, or choose another --out.")
    cache = own_folder(request.out, CACHE)
    scene = load_scene(request, context, cache, check=check, masks=masks)
    scene = with_useful_masks(scene, rois, context)
    every = request.test_every or RunConfig.test_every
    test = _there(test or list(choose_test_views(scene, rois, every)), photos, scene, context)
    frame = LocalFrame.of_scene(scene)
    scene, rois = frame.scene(scene), [frame.box(roi) for roi in rois]
    context = on_device(context, request.device)
    models: list[EvaluatedModel] = []
    for name, path in files.items():
        loaded = load_model(path, frame, context)
        models.append(EvaluatedModel(name=name, gaussians=loaded, seconds=0.0, stages={}))
    evaluation = evaluation_module.evaluate(
        models, scene, test, rois, context=context, baseline=models[0].name, photos=photos
    )
    table = write_evaluation(evaluation, models, scene, rois, request.out, context)
    return Evaluated().with_evaluation(request.out, table)


def write_evaluation(
    evaluation: Evaluation,
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    folder: Path,
    context: Context,
) -> str:
    """Write report, crops and page to a folder; return the table as Markdown."""
    from ..evaluation.crops import comparisons, write_crops
    from ..evaluation.report import format_markdown, write_report
    from ..evaluation.report_html import write_page

    write_report(evaluation, folder)
    write_crops(evaluation, models, scene, rois, folder, context=context)
    write_page(evaluation, comparisons(evaluation, models, scene, rois, context=context), folder)
    add_to_reports(folder)
    return format_markdown(evaluation)


def _there(wanted: Sequence[str], photos: str, scene: SfmScene, context: Context) -> list[str]:
    """Return the usable ones of the test photos, in the scene's order; warn of the others."""
    names = set(wanted)
    found = [image.name for image in scene.images if image.name in names]
    if len(found) < len(names):
        lost = counted(len(names) - len(found), f"{photos} photo")
        first = min(names - set(found))
        context.warn(f"Left out {lost} (unusable); the first is {first}.")
    return found


def _check_test_photos(test: Sequence[str], split: Path | None, cameras: SfmScene) -> None:
    """Raise ConfigError if the split has photos of another scene, or only unusable ones."""
    lost = {name for names in cameras.skipped.values() for name in names}
    unknown = sorted(set(test) - {image.name for image in cameras.images} - lost)
    if unknown:
        raise ConfigError(
            f"{split} names '{unknown[0]}', which is not in the scene.",
            "Use the split.json of a run on this scene.",
        )
    if test and lost.issuperset(test):
        raise ConfigError(
            f"All test photos of {split} are unusable; the first is {test[0]}.",
            "Restore the photos, or test on others (--test-every).",
        )


def _split_of_run(models: Sequence[Path], context: Context) -> Path | None:
    """Return the split of the run that made all models; None, with a warning, without one.

    A model of a run lies in its folder, or one or two folders below. The split does not hold for
    stages of earlier settings.
    """
    found = {_split_beside(path.absolute()) for path in models}
    split = found.pop()
    if split is None or found:
        context.warn(
            "The models may have been trained on these test photos. Give the split.json of "
            "their run (--split) to test on others."
        )
        return None
    context.info(f"Testing on the photos of {split}.")
    return split


def _split_beside(model: Path) -> Path | None:
    """Return the split of the run that made a model; None without one, or for an old stage."""
    for run in list(model.parents)[:3]:
        if (run / SPLIT).is_file():
            of_stage = model.is_relative_to(run / STAGES)
            is_present = model.parent in read_stage_list(run).values()
            return run / SPLIT if is_present or not of_stage else None
    return None


def held_out(model: Path) -> set[str]:
    """Return the names of the test and validation photos of a model's run; none without a run."""
    split = _split_beside(model.absolute())
    if split is None:
        return set()
    record = read_json(split, ConfigError, SPLIT_HINT)
    lists = [record.get(name) for name in PHOTOS] if isinstance(record, dict) else []
    return {name for names in lists if isinstance(names, list) for name in map(str, names)}


def _read_split(path: Path) -> tuple[str, list[str]]:
    """Return whether a run is evaluated on test or on validation photos, and their names."""
    hint = SPLIT_HINT
    record = read_json(path, ConfigError, hint)
    record = record if isinstance(record, dict) else {}
    photos = record.get("evaluate_on", TEST)
    if photos not in PHOTOS:
        raise ConfigError(f"{path}: 'evaluate_on' is neither {TEST} nor {VALIDATION}.", hint)
    names = record.get(photos)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{path} has no list '{photos}' of photo names.", hint)
    if not names:
        hint = "Use the split.json of a run with test photos, or --test-every."
        raise ConfigError(f"{path} names no {photos} photo.", hint)
    return photos, names
