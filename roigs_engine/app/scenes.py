"""Work on COLMAP projects: made from photos, inspected, exported, refined; photos selected."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import write_json
from ..model.roi import OrientedBox
from ..requests.projects import Export, Inspect, Reconstruct, RefineCameras, Select
from ..requests.values import AUTO
from .event_log import logged
from .inputs import BoxSource, boxes_of, load_scene, mask_options
from .outputs import Result, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from ..colmap.refine import Refinement
    from ..selection import CameraSelection


@dataclass(frozen=True, kw_only=True)
class Reconstructed(Result):
    """A COLMAP project, its report, and its model."""

    scene: Path
    report: Path
    model: Path

    @property
    def outputs(self) -> dict[str, str]:
        """Project and report."""
        return {"scene": str(self.scene), "report": str(self.report)}


def reconstruct(request: Reconstruct, context: Context = QUIET) -> Reconstructed:
    """Make a COLMAP project of photos or a video, or resume it.

    Raises:
        EngineError: the photos or the folder cannot be used, or a package is missing.
        Stopped: on request; the same request resumes.
    """
    from ..formats.projects import is_video
    from ..reconstruction import reconstruct as reconstruction  # needs Pillow, others do not
    from ..reconstruction.settings import Settings

    refuse_run_files(request.out)
    settings = Settings.of(vars(request))
    masks = mask_options(request)
    masks.check()
    if request.frames and not is_video(request.photos):
        raise ConfigError(f"{request.photos} is no video.", "Leave out --frames.")
    with logged(context) as (context, log):
        model = reconstruction.reconstruct(
            request.photos,
            request.out,
            settings,
            request.threads,
            context,
            log.open,
            frames=request.frames or 0,
            masks=masks,
        )
        report = request.out / "reconstruction.md"
        done = Reconstructed(scene=request.out, report=report, model=model)
        log.outputs = done.outputs
    return done


@dataclass(frozen=True, kw_only=True)
class Inspected(Result):
    """What a COLMAP model contains, ready for JSON."""

    report: dict[str, Any]


def inspect(request: Inspect, context: Context = QUIET) -> Inspected:
    """Load a scene and look what it contains; EngineError if it cannot be used."""
    from ..colmap.inspect import inspect_scene
    from ..colmap.photo_loader import without_damaged

    rois = boxes_of(request, required=False)
    scene = load_scene(request, context)
    if request.check_photos:
        scene = without_damaged(scene, context)
    return Inspected(report=inspect_scene(scene, rois))


@dataclass(frozen=True, kw_only=True)
class Exported(Result):
    """The number of cameras and points that were written."""

    cameras: int
    points: int


def export(request: Export, context: Context = QUIET) -> Exported:
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
    return Exported(files=paths, cameras=len(scene.images), points=len(scene.points))


@dataclass(frozen=True, kw_only=True)
class Refined(Result):
    """How much better cameras fit, and the new model's folder; None: they fitted already."""

    refinement: Refinement
    model: Path | None = None


def refine_cameras(request: RefineCameras, context: Context = QUIET) -> Refined:
    """Fit the cameras of a model better; EngineError if it cannot be used."""
    from ..colmap import refine
    from ..colmap.project import find_model
    from ..formats.projects import refined_folder

    refuse_run_files(request.out)
    model = find_model(request.scene, context)
    out: Path = request.out or refined_folder(model)
    done = refine.refine_cameras(
        model, out, context, images=request.images, look=not request.tracks_only
    )
    return Refined(refinement=done, model=out if done.better else None)


@dataclass(frozen=True, kw_only=True)
class Selected(Result):
    """The selections of the boxes, in their order; `files` has the lists that were written."""

    selections: tuple[CameraSelection, ...]


def select(request: Select, context: Context = QUIET) -> Selected:
    """Select the photos that show each box best; with `test_every`, test photos are left out.

    Raises:
        EngineError: a box or the scene cannot be used.
    """
    from ..model.mask_coverage import with_useful_masks
    from ..selection import SelectionConfig, select_cameras
    from ..selection.split import choose_test_views

    refuse_run_files(request.out)
    source = BoxSource.of(request, request.out)
    if AUTO not in request.roi:
        _lists(request, boxes_of(request))  # what is wrong is said before the scene is read
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
    for roi, selection in zip(rois, found, strict=True):
        if files:
            write_json(files[roi.name], selection.to_dict())
    return Selected(selections=found, files=files)


def _lists(request: Select, rois: Sequence[OrientedBox]) -> dict[str, Path]:
    """Box -> file to write, none of which is an input."""
    if request.out is None:
        return {}
    files = {roi.name: request.out / f"{roi.name}.json" for roi in rois}
    refuse_inputs(files.values(), [request.options_file, request.rois])
    return files
