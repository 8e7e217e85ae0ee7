"""Conversion of files of Gaussians: other formats, turned, cropped, or several placed as one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, RoiError
from ..exchange import formats, gltf
from ..exchange.arrays import turn
from ..formats.drawable import usable
from ..formats.gravity import gravity_alignment
from ..formats.targets import Target, target_with
from ..formats.text import counted
from ..machine import machine_memory
from ..model.roi import load_rois
from ..requests.models import Convert
from .inputs import boxes_of
from .instances import LIST, read_list
from .outputs import Result, refuse_inputs, refuse_run_files
from .run_scene import cameras_of_result, levelled_run, poses_of_run, up_in_run

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..exchange.arrays import Arrays
    from ..exchange.formats import FileFormat
    from ..exchange.page import Extras
    from ..model.scene import Float64

PAGE, STREAMED = ".html", "lod-meta.json"
SCENE_UP = "-y"
"""The axis that points up in formats that keep the frame of a scene."""
OTHER = "Choose another OUT."
COPIES = 5  # of a list's Gaussians in memory at once


@dataclass(frozen=True, kw_only=True)
class _Model:
    """Gaussians on their way to a file."""

    arrays: Arrays  # as they will be written
    count: int  # how many there were, with those that cannot be drawn
    target: Target  # what they are made for
    poses: Float64 | None  # (N, 4, 4) world_to_camera of photos, in the boxes' frame
    matrix: Float64  # (4, 4) from that frame to the file's
    upright: bool = False  # whether photos tell which way is up


def convert(request: Convert, context: Context = QUIET) -> Result:
    """Read the models, make them one, and write it; EngineError: input or options do not fit."""
    refuse_run_files(request.out)
    if request.source.suffix.lower() == ".glb" and gltf.is_mesh(request.source):
        return _mesh(request)
    if request.out.name == STREAMED:
        _refuse_page_options(request, plain=False)
        return _write_streamed(request, context)
    form = formats.writable(request.out)
    plain = request.plain or not form.keeps_antialiased
    _refuse_page_options(request, plain=plain)
    if request.source.suffix.lower() == LIST and not formats.is_named(request.source):
        model = _listed(request, form, context, plain=plain)
    else:
        model = _single(request, form, context, plain=plain)
    arrays = _shortened(model.arrays, request)
    context.check_cancelled()
    if model.target.antialiased and plain:
        _say_photos_unknown(form, context)
    if model.target.linear_light and not form.keeps_target:
        _warn_of_light(model.target, form, context)
    if form.suffix == PAGE:
        extras = _page_extras(request, _before(request, form.up, model, context), model)
        written = formats.write(request.out, arrays, target=model.target, extras=extras)
    else:
        check = context.check_cancelled
        written = formats.write(request.out, arrays, check, target=model.target)
    left = f" ({model.count - written:,} left out)" if model.count > written else ""
    size = request.out.stat().st_size / 1e6
    text = f"{counted(written, 'Gaussian')}{left}, {size:.1f} MB in {request.out}"
    return Result(files={"result": request.out}, text=text)


def _mesh(request: Convert) -> Result:
    """Convert a surface, or another textured mesh with y up."""
    from ..surface.files import UP, convert_mesh

    refuse_inputs([request.out], [request.source], OTHER)
    if request.out.suffix.lower() not in UP:
        raise ConfigError(
            f"{request.source} is a mesh, which {request.out.name} cannot hold.",
            f"Use {', '.join(UP)}.",
        )
    given = {
        "--rois": request.rois,
        "--sh-degree": request.sh_degree,
        "--plain": request.plain or None,
        "--from-up": request.from_up,
    }
    for option in (name for name, value in given.items() if value is not None):
        raise ConfigError(
            f"{option} is for Gaussians alone; {request.source} is a mesh.", "Leave it out."
        )
    _refuse_page_options(request, plain=False)
    faces = convert_mesh(request.source, request.out, request.up)
    size = request.out.stat().st_size / 1e6
    text = f"{counted(faces, 'face')}, {size:.1f} MB in {request.out}"
    return Result(files={"result": request.out}, text=text)


def _single(request: Convert, form: FileFormat, context: Context, *, plain: bool) -> _Model:
    from ..colmap.project import load_poses

    upright, poses = _upright(request, request.source, context), None
    home = _home(request, request.source, upright)
    matrix = turn(SCENE_UP, request.up or form.up) @ upright
    if form.suffix == PAGE and request.page_scene is not None:
        poses = load_poses(request.page_scene)
    elif form.suffix == PAGE and not request.from_up:
        poses = poses_of_run(request.source.absolute().parent)
    if poses is not None:
        matrix = turn("z", request.up or form.up)
        matrix[:3, :3] = matrix[:3, :3] @ gravity_alignment(poses)
        matrix = matrix @ home
    elif request.from_up is None:
        usual = formats.format_of(request.source).up
        if (upright == turn(usual, SCENE_UP)).all():
            _warn_of_axes(request.source, usual, context)
        else:
            context.info(
                f"{request.source.name} says how its axes point, so it is turned."
                " If it lies wrong, give --from-up."
            )
    refuse_inputs([request.out], [request.source], OTHER)
    whole, target = _read(request.source, context, plain=plain, scene=request.page_scene)
    arrays = _cropped(whole, request, home)
    context.check_cancelled()
    return _Model(
        arrays=turned(arrays, matrix),
        count=len(arrays["means"]),
        target=target,
        poses=poses,
        matrix=matrix @ home.T,
        upright=poses is not None,
    )


def _listed(request: Convert, form: FileFormat, context: Context, *, plain: bool) -> _Model:
    from ..exchange.transform import merged
    from ..model.gaussians import Gaussians

    if boxes_of(request, required=False):
        raise ConfigError("A list of models cannot be cropped.", "Leave out the boxes.")
    wanted, poses = read_list(request.source, context)
    refuse_inputs([request.out], [request.source, *(Path(item.file) for item in wanted)], OTHER)
    names = dict.fromkeys(item.file for item in wanted)
    models = {}
    for name in names:
        context.check_cancelled()
        models[name] = _read(Path(name), context, plain=plain, scene=request.page_scene)
    _refuse_too_many(request.source, [models[item.file][0] for item in wanted])
    read = {}
    for name, (arrays, _) in models.items():
        context.check_cancelled()
        read[name] = Gaussians.framed(usable(arrays))
    if not any(len(gaussians) for gaussians, _ in read.values()):
        raise ConfigError(f"{request.source} has no Gaussians.", "Give models that have some.")
    targets = {Path(name): target for name, (_, target) in models.items()}
    if plain:  # files whose photos are not known stay anti-aliased, and so all are said to be
        still = any(target.antialiased for target in targets.values())
        targets = {
            path: target_with(antialiased=still, linear_light=target.linear_light)
            for path, target in targets.items()
        }
    matrix = turn(request.from_up or SCENE_UP, request.up or form.up)
    whole, frame = merged([item.of(*read[item.file], matrix) for item in wanted], context)
    return _Model(
        arrays=whole.arrays(frame),
        count=sum(len(models[item.file][0]["means"]) for item in wanted),
        target=formats.common_target(targets),
        poses=poses,
        matrix=matrix,
    )


def _refuse_too_many(source: Path, models: Sequence[Arrays]) -> None:
    """Raise ConfigError if the models of a list, each as often as it is named, need too much."""
    count = sum(len(arrays["means"]) for arrays in models)
    bands = max(arrays["sh"].shape[1] for arrays in models)
    needed, memory = COPIES * 4 * (11 + 3 * bands) * count, machine_memory()
    if needed > memory:
        raise ConfigError(
            f"{source} names {counted(count, 'Gaussian')} in all, which need {needed / 1e9:.1f} GB"
            f" of memory; this machine has {memory / 1e9:.1f} GB.",
            "Name fewer models, or smaller ones.",
        )


def _home(request: Convert, path: Path, upright: Float64) -> Float64:
    """(4, 4) from a file's frame to that of the scene, in which boxes and photos are.

    Formats with -y up keep the scene's frame, whichever axis points up in it. A file of another
    format was turned; OUT, if it is one that keeps the scene's frame, tells how to turn it back.
    `upright`: see `_upright`.
    """
    if formats.format_of(path).up == SCENE_UP:
        return np.eye(4)
    own = formats.format_of(request.out).up == SCENE_UP
    up = request.up if request.up and own else SCENE_UP
    return turn(SCENE_UP, up) @ upright


def _upright(request: Convert, path: Path, context: Context) -> Float64:
    """(4, 4) from a file's frame to one in which -y points up.

    By --from-up, else by what the file says, else as its format has it. A file that says that its
    axes are left-handed is mirrored in both cases.
    """
    said = context.interruptible(lambda: formats.frame(path))
    if request.from_up is None:
        matrix: Float64 = turn(formats.format_of(path).up, SCENE_UP) @ said
    else:
        mirror = np.diag((np.linalg.det(said).round(), 1, 1, 1))
        matrix = turn(request.from_up, SCENE_UP) @ mirror
    return matrix


def _cropped(arrays: Arrays, request: Convert, home: Float64) -> Arrays:
    """What is in the boxes; everything if none is given. `home` leads to the boxes' frame."""
    rois = boxes_of(request, required=False)
    if not rois:
        return arrays
    with np.errstate(invalid="ignore"):  # what is not finite is in no box
        means = arrays["means"].astype(np.float64) @ home[:3, :3].T
    inside = np.any([roi.contains(means) for roi in rois], axis=0)
    if not inside.any():
        raise RoiError("The boxes hold no Gaussian.", "Are they from the same scene?")
    return {name: values[inside] for name, values in arrays.items()}


def _warn_of_axes(source: Path, before: str, context: Context) -> None:
    """Say so if a run's model would lie on its side: some COLMAP models have another axis up."""
    up = up_in_run(source)
    if up not in (None, before):
        context.warn(
            f"In this model, {up} points up, and not {before}, so it lies on its side now."
            f" Choose {up} as its axis that points up (--from-up={up})."
        )


def _shortened(arrays: Arrays, request: Convert) -> Arrays:
    if request.sh_degree is None:
        return arrays
    return {**arrays, "sh": arrays["sh"][:, : (request.sh_degree + 1) ** 2]}


def turned(arrays: Arrays, matrix: Float64) -> Arrays:
    """The model after a rotation; bit for bit the same if that changes nothing."""
    from ..exchange.transform import moved

    if (matrix == np.eye(4)).all():
        return arrays
    arrays = usable(arrays)
    if not len(arrays["means"]):
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    return moved(arrays, matrix)


# --- viewers without anti-aliasing ---


def _read(
    path: Path, context: Context, *, plain: bool, scene: Path | None = None
) -> tuple[Arrays, Target]:
    """The Gaussians of a file, and what they are made for.

    With `plain`, they are made about right without it, as far as photos tell how: those of `scene`,
    or of the run that made the file.
    """
    from ..exchange.transform import without_antialiasing
    from ..model.gaussians import Gaussians

    target = context.interruptible(lambda: formats.target_of(path))
    arrays = _arrays(path, context)
    photos = cameras_of_result(path, scene) if target.antialiased and plain else None
    if photos is None:
        return arrays, target
    model, frame = Gaussians.framed(arrays, target=target)
    made = without_antialiasing(model, frame.scene(photos).images)
    return {**arrays, "logit_opacities": made.logit_opacities.numpy()}, made.target


def _arrays(path: Path, context: Context) -> Arrays:
    return context.interruptible(lambda: formats.read(path, context.check_cancelled))


def _warn_of_light(target: Target, form: FileFormat, context: Context) -> None:
    """Say that a format cannot tell other programs in which light to blend."""
    context.warn(
        f"{form.title} cannot say that these Gaussians are made for {target.title}: other programs"
        " will show them too dark. Make them for these first (`adapt`)."
    )


def _say_photos_unknown(form: FileFormat, context: Context) -> None:
    """Refuse to write anti-aliased Gaussians as plain ones; warn if the format cannot tell."""
    why = "the photos that they were trained on are not known"
    if form.keeps_antialiased:
        raise ConfigError(
            f"--plain cannot change these Gaussians, as {why}.",
            "Give their scene's folder with --scene, or leave out --plain.",
        )
    context.warn(
        f"{form.title} cannot say that these Gaussians are anti-aliased, and {why}: other"
        " programs will show fine ones too thick. Give their scene's folder with --scene, or write"
        " .ply, .spz, .sog or .html."
    )


# --- web pages ---


def _refuse_page_options(request: Convert, *, plain: bool) -> None:
    """Raise ConfigError if an option of pages is given for another format.

    For viewers without anti-aliasing (`plain`), other formats need the scene too.
    """
    given = {
        "--title": request.title,
        "--fly-to": request.fly_to,
        "--before": request.before,
        "--mesh": request.mesh or None,
        "--scene": None if plain else request.page_scene,
    }
    if request.out.suffix.lower() != PAGE:
        for option in (name for name, value in given.items() if value is not None):
            also = " and --plain" if option == "--scene" else ""
            raise ConfigError(
                f"{option} is for web pages{also} alone.",
                f"Leave it out, or let OUT end in {PAGE}.",
            )
    elif request.page_scene is not None and request.from_up is not None:
        raise ConfigError("--scene and --from-up both say which way is up.", "Leave out one.")


def _before(request: Convert, up: str, model: _Model, context: Context) -> Arrays | None:
    """The model of `--before`, as the first one is shown."""
    if request.before is None:
        return None
    refuse_inputs([request.out], [request.before], OTHER)
    upright = _upright(request, request.before, context)
    home = _home(request, request.before, upright)
    own = turn(SCENE_UP, request.up or up) @ upright
    matrix = model.matrix @ home if model.upright else own
    arrays = _cropped(_arrays(request.before, context), request, home)
    return _shortened(turned(arrays, matrix), request)


def _page_extras(request: Convert, before: Arrays | None, model: _Model) -> Extras:
    """What the page shows besides, with boxes and photos turned as the model is."""
    from ..exchange.page import Ball, Extras

    matrix, poses = model.matrix, model.poses
    places = []
    for box in load_rois(request.fly_to) if request.fly_to else []:
        centre = matrix[:3, :3] @ box.centre + matrix[:3, 3]
        ball = Ball(centre=centre, radius=float(np.linalg.norm(box.half_extents)))
        places.append((box.name, ball))
    meshes = []
    for file in request.mesh:
        from ..surface.files import page_meshes

        refuse_inputs([request.out], [file], OTHER)
        meshes += page_meshes(file, matrix)
    shown = None if request.before is None else formats.target_of(request.before)
    return Extras(
        title=request.title or "",
        places=places,
        before=before,
        before_antialiased=shown is not None and shown.antialiased,
        poses=None if poses is None else poses @ np.linalg.inv(matrix),
        meshes=meshes,
    )


# --- levels of detail ---


def _write_streamed(request: Convert, context: Context) -> Result:
    from ..exchange import streamed_sog
    from ..formats.levels import read_ladders

    folder = levelled_run(request.source)
    if boxes_of(request, required=False):
        raise ConfigError(f"{STREAMED} holds a whole result.", "Leave out the boxes.")
    if request.plain:
        raise ConfigError(f"{STREAMED} says how its Gaussians are drawn.", "Leave out --plain.")
    before = request.from_up or SCENE_UP
    matrix = turn(before, request.up or SCENE_UP)
    if request.from_up is None:
        _warn_of_axes(request.source, before, context)
    parts, files = [], []
    for ladder in read_ladders(folder).values():
        levels = []
        for level in ladder.levels:
            file = folder / level.ply
            refuse_inputs([request.out], [file], OTHER)
            context.check_cancelled()
            arrays = _arrays(file, context)
            levels.append(_shortened(turned(arrays, matrix), request))
            files.append(file)
        parts.append(levels)
    target = formats.common_target({file: formats.target_of(file) for file in files})
    if target.linear_light:
        _warn_of_light(target, formats.format_of(Path("meta.json")), context)
    check, smooth = context.check_cancelled, target.antialiased
    written = streamed_sog.write(request.out, parts, check, antialiased=smooth)
    text = f"{counted(written, 'Gaussian')} in levels of detail in {request.out.parent}"
    return Result(files={"result": request.out}, text=text)
