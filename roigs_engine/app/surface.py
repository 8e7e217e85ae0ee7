"""Makes meshes of a finished run: one beside each box's PLY, and the background."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import ConfigError, RoiError, RunFolderError, SceneError
from ..formats import run_files
from ..formats.files import (
    own_folder,
    read_record,
    refuse_linked_folders,
    sha256,
    write_json,
)
from ..formats.gravity import gravity_alignment
from ..formats.lock import check_held, locked
from ..formats.names import same_name
from ..formats.text import json_digest
from ..requests.runs import MakeSurface
from .asked import Asked
from .inputs import load_model
from .outputs import Result
from .surface_record import PICTURE, RECORD, SurfaceRecord, add_to_reports, read_surface

if TYPE_CHECKING:
    from ..model.gaussians import Gaussians
    from ..model.roi import OrientedBox
    from ..run.definition import Run
    from ..surface.make import Surface, SurfaceOptions
    from ..surface.mesh import Mesh

GLB = ".glb"
BESIDE = {".obj": (".mtl", ".png"), ".usda": (".png",), ".usdc": (".png",)}
"""Endings of the files that those of a mesh have beside them."""
STEEP = 0.7  # cosine between up and a hole that is above or below
VERSION = 4  # increase it if the same inputs become another mesh


@dataclass(frozen=True, kw_only=True)
class Surfaces(Result):
    """The surfaces of a run's boxes."""

    surfaces: tuple[SurfaceRecord, ...] = ()


def make_surfaces(request: MakeSurface, context: Context = QUIET) -> Surfaces:
    """Make the surfaces of a finished run's boxes, or of its background, in its folder.

    Raises:
        EngineError: the run folder or its scene cannot be used, or no box has a surface.
        Stopped: on request; finished surfaces stay.
    """
    from ..surface.make import SurfaceOptions, check_packages

    check_packages()
    given = {"device": request.device, "threads": request.threads}
    asked = Asked.of_run(request.run, request.scene, **given)
    for name in request.only:
        if name not in asked.boxes.names:
            boxes = ", ".join(asked.boxes.names)
            raise RoiError(f"There is no box '{name}'.", f"The boxes are: {boxes}.")
    if request.background:
        _check_background(request, asked.boxes.names)
    options = SurfaceOptions(
        faces=request.faces,
        watertight=request.watertight,
        texture_size=request.texture_size,
    )
    with locked(request.run, context.warn, option=None):
        refuse_linked_folders(request.run)
        run, context = asked.trained(context)
        names = request.only or (() if request.background else asked.boxes.names)
        gaussians = _gaussians(run, context)
        rois = [roi for roi in run.rois if roi.name in names]
        work = [partial(_of_box, gaussians, run, roi, options) for roi in rois]
        if work:
            _say_before(gaussians, run, names, context)
        if request.background:
            work.append(partial(_of_background, gaussians, run, options, context))
        return _made(work, run, request.format, context)


def surfaces_of_run(run: Run, options: SurfaceOptions, context: Context = QUIET) -> Surfaces:
    """Make the surfaces of a run's boxes in its folder, which is locked; see `make_surfaces`."""
    gaussians = _gaussians(run, context)
    _say_before(gaussians, run, [roi.name for roi in run.rois], context)
    work = [partial(_of_box, gaussians, run, roi, options) for roi in run.rois]
    return _made(work, run, (), context)


@dataclass(frozen=True, kw_only=True)
class _Work:
    """A surface to make."""

    name: str  # of its files
    title: str
    inputs: str  # hash of everything that decides it
    make: Callable[[Context], Surface]
    roi: OrientedBox  # its size is measured along this box's axes


def _of_box(gaussians: Gaussians, run: Run, roi: OrientedBox, options: SurfaceOptions) -> _Work:
    from ..surface.make import make_surface

    return _Work(
        name=roi.name,
        title=f"Box '{roi.name}'",
        inputs=_inputs(gaussians, run, roi, options),
        make=lambda context: make_surface(
            gaussians, run.train_scene, roi, options, context=context
        ),
        roi=roi,
    )


def _of_background(
    gaussians: Gaussians, run: Run, options: SurfaceOptions, context: Context
) -> _Work:
    """The work for the background; it leaves out what the boxes' own meshes show."""
    from ..surface.background import background_plan, make_background, surroundings
    from ..surface.files import read_points

    own, digests = {}, {}
    for roi in run.rois:
        path = run.folder / run_files.FINE / f"{roi.name}{GLB}"
        if path.is_file():
            own[roi.name] = read_points(path, run.frame, context)
            digests[roi.name] = sha256(path)
    whole = surroundings(run.train_scene)

    def make(context: Context) -> Surface:
        context.info(background_plan(run.train_scene, len(gaussians)).text)
        return make_background(gaussians, run.train_scene, run.rois, own, options, context=context)

    boxes = [digests, [roi.to_dict() for roi in run.rois]]
    return _Work(
        name=run_files.SURROUNDINGS,
        title="Background",
        inputs=json_digest([_inputs(gaussians, run, whole, options), boxes]),
        make=make,
        roi=whole,
    )


def _made(
    work: Sequence[Callable[[], _Work]], run: Run, formats: Sequence[str], context: Context
) -> Surfaces:
    """Make the surfaces that are missing; return all with their paths.

    Args:
        work: returns each surface's work when it is its turn: the background depends on the boxes'
            meshes.
        run: the run.
        formats: endings of further files to write.
        context: receives messages.
    """
    folder = own_folder(run.folder, run_files.FINE)
    records, files, failed = [], {}, None
    for planned in work:
        each = planned()
        path = folder / f"{each.name}{GLB}"
        record = _finished(path, each.inputs, formats)
        if record is not None:
            context.info(f"{each.title}: its surface already exists.")
        else:
            try:
                made = each.make(context)
            except SceneError as error:
                failed = error
                context.warn(error.message)
                continue
            check_held(run.folder)
            record = _record(made, run, each.roi)
            digests = _write(path, made, run, formats)
            finished = asdict(record) | {"inputs": each.inputs, "files": digests}
            write_json(path.with_suffix(RECORD), finished)
            context.info(record.text)
        records.append(record)
        files[each.name] = path
    if failed is not None and not records:
        raise failed
    add_to_reports(run.folder)
    done = Surfaces(files=files, surfaces=tuple(records))
    return done.with_places(*(record.text for record in records))


def _check_background(request: MakeSurface, boxes: Sequence[str]) -> None:
    """Raise ConfigError or RoiError if the request for a background cannot be met."""
    if request.watertight and not request.only:
        raise ConfigError("--watertight is for boxes; a background is open.", "Leave it out.")
    if any(same_name(name) == run_files.SURROUNDINGS for name in boxes):
        raise RoiError(
            f"A box has the name '{run_files.SURROUNDINGS}' of the background's files.",
            "Rename the box, and train again.",
        )


def _gaussians(run: Run, context: Context) -> Gaussians:
    """Return the run's result after further training for surfaces; unchanged without its stages.

    Masks drawn after the training cut the mesh, but are not used for training.
    """
    from ..run.folder import train_surface

    unmasked = tuple(replace(image, objects={}) for image in run.scene.images)
    found = train_surface(run, context)
    if found is None and any(image.objects for image in run.scene.images):
        found = train_surface(replace(run, scene=replace(run.scene, images=unmasked)), context)
    if found is not None:
        return found
    context.warn(
        "The training's stages are gone, or its settings have changed: surfaces are made from "
        "the result without further training, and are less exact."
    )
    return load_model(run.folder / run_files.RESULT, run.frame, context)


def _say_before(gaussians: Gaussians, run: Run, names: Sequence[str], context: Context) -> None:
    """Report the memory needed, and the boxes whose objects stay joined to their support."""
    from ..surface.make import surface_plan
    from ..surface.objects import has_masks

    rois = [roi for roi in run.rois if roi.name in names]
    plans = [surface_plan(gaussians, run.train_scene, roi) for roi in rois]
    context.info(max(plans, key=lambda plan: plan.memory).text)
    whole = [f"'{roi.name}'" for roi in rois if not has_masks(run.train_scene, roi)]
    if whole:
        context.info(
            f"No masks of the objects in {', '.join(whole)}: their support becomes a part of "
            "them. To cut it off, draw strokes on a photo (Object Masks in Blender, or "
            "`masks`)."
        )


def _inputs(gaussians: Gaussians, run: Run, roi: OrientedBox, options: SurfaceOptions) -> str:
    """Return a hash of everything that decides a box's surface."""
    model = hashlib.sha256()
    for tensor in gaussians.tensors().values():
        model.update(tensor.detach().cpu().numpy().tobytes())
    from ..run.plan import camera_record

    photos = [(image.name, image.digest, *camera_record(image)) for image in run.train_scene.images]
    masks = [
        (image.name, image.objects[roi.name].digest)
        for image in run.train_scene.images
        if roi.name in image.objects
    ]
    place = run.frame.origin.tolist(), run.frame.scale, _upright(run).tolist()
    settings = VERSION, asdict(options), roi.to_dict()
    return json_digest([model.hexdigest(), photos, masks, place, settings])


def _finished(path: Path, inputs: str, formats: Sequence[str]) -> SurfaceRecord | None:
    """Return the record of a surface with the same inputs and intact files; None without one."""
    try:
        record = read_record(path.with_suffix(RECORD))
        digests = record["files"]
        same = record["inputs"] == inputs and digests.keys() >= set(_names(path, formats))
        if not same or any(sha256(path.parent / f) != digests[f] for f in digests):
            return None
        return read_surface(path.with_suffix(RECORD))
    except (RunFolderError, OSError, KeyError, TypeError, ValueError, AttributeError):
        return None


def _names(path: Path, formats: Sequence[str]) -> list[str]:
    """Return the names of the files of a mesh, the .glb first."""
    endings = dict.fromkeys((GLB, *(f".{name}" for name in formats)))
    # The name of the box's own PLY is taken by its Gaussians.
    others = {".ply": ".surface.ply"}
    return [path.with_suffix(others.get(ending, ending)).name for ending in endings]


def _write(path: Path, made: Surface, run: Run, formats: Sequence[str]) -> dict[str, str]:
    """Write the files of a mesh; return their digests by name."""
    from ..rasterize.image_files import save_png
    from ..surface.clay import clay
    from ..surface.files import convert_mesh, write_mesh

    up = np.eye(4)
    up[:3, :3] = _upright(run)
    first, *others = [path.parent / name for name in _names(path, formats)]
    write_mesh(first, made.textured, run.frame, up)
    for file in others:
        convert_mesh(first, file)
    picture = path.with_suffix(PICTURE)
    save_png(picture, clay(made.mesh, up[:3, :3]))
    beside = (file.with_suffix(end) for file in others for end in BESIDE.get(file.suffix, ()))
    whole = (first, *others, picture, *filter(Path.is_file, dict.fromkeys(beside)))
    return {file.name: sha256(file) for file in whole}


def _upright(run: Run) -> NDArray[np.float64]:
    """(3, 3) rotation of the world that makes +y point up, as in glTF."""
    poses = np.array([image.world_to_camera for image in run.scene.images])
    z_up = gravity_alignment(poses)
    return np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float) @ z_up


def _record(made: Surface, run: Run, roi: OrientedBox) -> SurfaceRecord:
    mesh, scale = made.mesh, run.frame.scale
    local = mesh.vertices @ roi.world_to_box[:3, :3].T
    size = np.ptp(local, axis=0) / scale
    closed = mesh.is_closed()
    model = run.folder / run_files.FINE / f"{roi.name}.ply"
    return SurfaceRecord(
        box=roi.name,
        file=f"{run_files.FINE}/{roi.name}{GLB}",
        result=sha256(model) if model.is_file() else "",
        faces=len(mesh.faces),
        vertices=len(mesh.vertices),
        parts=len(np.unique(mesh.parts())),
        size=(float(size[0]), float(size[1]), float(size[2])),
        area=float(mesh.areas.sum()) / scale**2,
        volume=mesh.volume() / scale**3 if closed else None,
        watertight=closed,
        filled=made.filled,
        untextured=1 - made.textured.seen,
        unseen={} if roi.name == run_files.SURROUNDINGS else _unseen(mesh, _upright(run)),
        voxel=made.voxel / scale,
        texture=made.textured.charts.side,
        photos=made.photos,
    )


def _unseen(mesh: Mesh, upright: NDArray[np.float64]) -> dict[str, float]:
    """Return side -> area of the holes there, as a share of the surface including its holes."""
    holes = mesh.holes() @ upright.T
    areas = np.linalg.norm(holes, axis=1)
    up = holes[:, 1] / np.maximum(areas, 1e-30)
    sides = {"above": up > STEEP, "below": up < -STEEP, "beside": np.abs(up) <= STEEP}
    whole = max(float(mesh.areas.sum() + areas.sum()), 1e-30)
    return {side: float(areas[on].sum()) / whole for side, on in sides.items() if on.any()}
