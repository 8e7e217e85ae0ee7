"""Commands on COLMAP projects: reconstruct, inspect, export, refine, select photos."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder, write_json
from ..formats.text import counted
from ..model.roi import OrientedBox
from ..requests.projects import Export, Inspect, Reconstruct, RefineCameras, Select, ShowPhoto
from .event_log import logged
from .inputs import BoxSource, boxes_of, load_scene, mask_options
from .outputs import Result, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from ..colmap.refine import Refinement
    from ..colmap.refine_by_matches import MatchedFit
    from ..selection import CameraSelection


def reconstruct(request: Reconstruct, context: Context = QUIET) -> Result:
    """Make a COLMAP project from photos or a video, or resume it.

    Raises:
        EngineError: the photos or the folder cannot be used, or a package is missing.
        Stopped: on request; the same request resumes.
    """
    from ..reconstruction import reconstruct as reconstruction  # needs Pillow, the others do not

    refuse_run_files(request.out)
    with logged(context) as (context, log):
        model = reconstruction.reconstruct(request, mask_options(request), context, log.open)
        files = {"scene": request.out, "report": request.out / "reconstruction.md", "model": model}
        done = Result(files=files).with_places()
        log.outputs = done.outputs
    return done


@dataclass(frozen=True, kw_only=True)
class Inspected(Result):
    """The content of a COLMAP model, ready for JSON."""

    report: dict[str, Any]


def inspect(request: Inspect, context: Context = QUIET) -> Inspected:
    """Load a scene and report its content; EngineError if it cannot be used."""
    from ..colmap.inspect import format_inspection, inspect_scene
    from ..colmap.photo_loader import without_damaged

    rois = boxes_of(request, required=False)
    scene = load_scene(request, context, contents=request.check_photos)
    if request.check_photos:
        scene = without_damaged(scene, context)
    report = inspect_scene(scene, rois)
    if request.check_photos:
        from ..guidance.faults import photo_faults
        from ..guidance.known import known_box

        for box, roi in zip(report["rois"], rois, strict=True):
            found = (
                photo_faults(known_box(scene, roi, context))
                if box["points"] and box["photos"]
                else ()
            )
            box["faults"] = [fault.to_dict() for fault in found]
    text = json.dumps(report, indent=1) if request.json else format_inspection(report)
    return Inspected(report=report, text=text)


def export(request: Export, context: Context = QUIET) -> Result:
    """Write a model's cameras and points; EngineError if it cannot be used."""
    from ..colmap.export import COLMAP, PLACED, SCENE, stored_transform, transformed, write_export
    from ..formats.scene_transform import transform_file

    refuse_run_files(request.out)
    refuse_inputs([request.out / SCENE], [request.options_file])
    scene = load_scene(request, context)
    transform = None
    try:
        if request.placed or os.path.lexists(transform_file(request.scene)):
            transform = stored_transform(request.scene, scene)
    except ConfigError as error:
        if request.placed:
            raise
        context.warn(str(error))
    if transform is not None and request.placed:
        scene = transformed(scene, transform)
    frame = PLACED if request.placed else COLMAP
    files = write_export(scene, request.out, transform=transform, frame=frame)
    paths = {name: Path(path) for name, path in files.items()}
    cameras, points = counted(len(scene.images), "camera"), counted(len(scene.points), "point")
    return Result(files=paths, text=f"{cameras} and {points} in {request.out}")


def show_photo(request: ShowPhoto, context: Context = QUIET) -> Result:
    """Write a picture of a photo as training sees it; EngineError if that is not possible."""
    from ..colmap.records import lens_from_words
    from ..colmap.shown_photo import write_shown

    refuse_run_files(request.out)
    refuse_inputs([request.out], [request.photo_file, request.options_file])
    lens = lens_from_words(request.lens) if request.lens else None
    write_shown(
        request.photo_file,
        request.out,
        context,
        lens=lens,
        turn=request.turn,
        side=request.max_side,
    )
    return Result(files={"picture": request.out}).with_places()


@dataclass(frozen=True, kw_only=True)
class Refined(Result):
    """The improvement of the cameras, and the new model's folder; None if they already fitted."""

    refinement: Refinement
    model: Path | None = None


def refine_cameras(request: RefineCameras, context: Context = QUIET) -> Refined:
    """Refine the cameras of a model; EngineError if it cannot be used."""
    from ..colmap import refine
    from ..colmap.project import find_model
    from ..formats.projects import refined_folder, top_folder

    refuse_run_files(request.out)
    model = find_model(request.scene, context)
    out = request.out
    if out is None:  # the project may be somebody else's, and have links
        out = refined_folder(model)
        project = request.scene if out.is_relative_to(request.scene) else top_folder(model)
        own_folder(project, str(out.relative_to(project)))
    done = refine.refine_cameras(
        model, out, context, images=request.images, look=not request.tracks_only
    )
    text = " ".join([_by_tracks(done), *_by_matches(done.matched)])
    if not done.better:
        return Refined(refinement=done, text=text)
    text += f"\nThe new model is in {out}. Use this folder as the scene; boxes stay as they are."
    return Refined(refinement=done, model=out, text=text)


def _by_tracks(done: Refinement) -> str:
    count = counted(done.left_out, "observation")
    errors = f"{done.before:.2f} -> {done.after:.2f} px, median of {count} left out"
    if not done.fits_tracks_better:
        nothing = "" if done.better else " Nothing is written."
        return f"The cameras already fit the tracks as well as they can ({errors}).{nothing}"
    fuller = f" {counted(done.cameras, 'camera')} got OPENCV's parameters." if done.cameras else ""
    return f"The cameras fit better: {errors}.{fuller}"


def _by_matches(fit: MatchedFit | None) -> list[str]:
    if fit is None:
        return []
    if not fit.enough:
        return [f"Only {counted(fit.matches, 'place')} matched in the photos: they were not used."]
    matched = f"{counted(fit.matches, 'place')} matched in {counted(fit.photos, 'photo')}"
    if not fit.better:
        return [f"With {matched}, they fit as well as they can ({fit.after:.3f} px)."]
    errors = f"{fit.before:.3f} -> {fit.after:.3f} px, median of {fit.left_out:,} left out"
    changed = " and ".join([", ".join(fit.changed[:-1]), fit.changed[-1]]).removeprefix(" and ")
    return [f"With {matched}: {errors} ({changed} changed)."]


@dataclass(frozen=True, kw_only=True)
class Selected(Result):
    """The selections of the boxes, in their order; `files` has the written lists."""

    selections: tuple[CameraSelection, ...]


def select(request: Select, context: Context = QUIET) -> Selected:
    """Select the photos that show each box best; with `test_every`, test photos are left out.

    EngineError: a box or the scene cannot be used.
    """
    from ..model.mask_coverage import with_useful_masks
    from ..selection import SelectionConfig, format_selection, select_cameras
    from ..selection.split import choose_test_views

    refuse_run_files(request.out)
    source = BoxSource.of(request, request.out)
    if source.given is not None:
        _lists(request, source.given)  # reports errors before the scene is read
    given = {name: getattr(request, name) for name in ("method", "count", "seed")}
    config = replace(SelectionConfig(), **{k: v for k, v in given.items() if v is not None})
    scene = load_scene(request, context, masks=mask_options(request, source.names))
    rois = source.boxes(scene)
    scene = with_useful_masks(scene, rois, context)
    files = _lists(request, rois)
    source.keep(rois, context)
    tests = None
    if request.test_every is not None:
        test = choose_test_views(scene, rois, request.test_every, context)
        scene, tests = scene.without(set(test)), scene.select(test)
    found = tuple(select_cameras(scene, roi, config, context, tests=tests) for roi in rois)
    texts = [format_selection(selection) for selection in found]
    if files:
        for roi, selection in zip(rois, found, strict=True):
            write_json(files[roi.name], selection.to_dict())
        texts.append(f"{counted(len(files), 'list')} of photos in {request.out}")
    return Selected(selections=found, files=files, text="\n".join(texts))


def _lists(request: Select, rois: Sequence[OrientedBox]) -> dict[str, Path]:
    """Return box -> file to write; refuse to replace inputs."""
    if request.out is None:
        return {}
    files = {roi.name: request.out / f"{roi.name}.json" for roi in rois}
    refuse_inputs(files.values(), [request.options_file, request.rois])
    return files
