"""Reads the Gaussians of a file, or of a list of files, for a conversion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...context import Context
from ...errors import ConfigError
from ...exchange import formats
from ...exchange.arrays import turn
from ...formats.drawable import usable
from ...formats.gravity import gravity_alignment
from ...formats.targets import Target, target_with
from ...formats.text import counted
from ...machine import machine_memory
from ...requests.models import Convert
from ..inputs import boxes_of
from ..instances import read_list
from ..run_scene import poses_of_run
from .axes import SCENE_UP, to_home, to_upright, turned, warn_of_axes
from .reading import cropped, read_model, refuse_own_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ...exchange.arrays import Arrays
    from ...exchange.formats import FileFormat
    from ...model.scene import Float64

COPIES = 5  # copies of a list's Gaussians in memory at once


@dataclass(frozen=True, kw_only=True)
class Model:
    """Gaussians to write to a file."""

    arrays: Arrays  # in the file's frame
    count: int  # number of Gaussians, including those that cannot be drawn
    target: Target  # renderer that they are made for
    photo_focal: float | None  # of `Gaussians`
    poses: Float64 | None  # (N, 4, 4) world_to_camera of photos, in the boxes' frame
    matrix: Float64  # (4, 4) from the boxes' frame to the file's
    upright: bool = False  # whether photos determine the up direction


def single(request: Convert, form: FileFormat, context: Context, *, plain: bool) -> Model:
    """Read the Gaussians of SOURCE, rotated for a format; raises as `convert` does."""
    from ...colmap.project import load_poses

    upright, poses = to_upright(request, request.source, context), None
    home = to_home(request, request.source, upright)
    matrix = turn(SCENE_UP, request.up or form.up) @ upright
    if form.suffix == formats.PAGE and request.page_scene is not None:
        poses = load_poses(request.page_scene)
    elif form.suffix == formats.PAGE and not request.from_up:
        poses = poses_of_run(request.source.absolute().parent)
    if poses is not None:
        matrix = turn("z", request.up or form.up)
        matrix[:3, :3] = matrix[:3, :3] @ gravity_alignment(poses)
        matrix = matrix @ home
    elif request.from_up is None:
        usual = formats.format_of(request.source).up
        if (upright == turn(usual, SCENE_UP)).all():
            warn_of_axes(request.source, usual, context)
        else:
            context.info(
                f"{request.source.name} records its axes, so it is rotated. If it lies on its "
                "side, give --from-up."
            )
    refuse_own_inputs(request, request.source)
    whole, target = read_model(request.source, context, plain=plain, scene=request.page_scene)
    arrays = cropped(whole, request, home)
    context.check_cancelled()
    return Model(
        arrays=turned(arrays, matrix),
        count=len(arrays["means"]),
        target=target,
        photo_focal=formats.photo_focal_of(request.source),
        poses=poses,
        matrix=matrix @ home.T,
        upright=poses is not None,
    )


def listed(request: Convert, form: FileFormat, context: Context, *, plain: bool) -> Model:
    """Read the models of a list as one, rotated for a format; raises as `convert` does."""
    from ...exchange.transform import merged
    from ...model.gaussians import Gaussians

    if boxes_of(request, required=False):
        raise ConfigError("A list of models cannot be cropped.", "Leave out the boxes.")
    wanted, poses = read_list(request.source, context)
    refuse_own_inputs(request, request.source, *(Path(item.file) for item in wanted))
    names = dict.fromkeys(item.file for item in wanted)
    models = {}
    for name in names:
        context.check_cancelled()
        models[name] = read_model(Path(name), context, plain=plain, scene=request.page_scene)
    _refuse_too_many(request.source, [models[item.file][0] for item in wanted])
    read = {}
    for name, (arrays, _) in models.items():
        context.check_cancelled()
        focal = formats.photo_focal_of(Path(name))
        read[name] = Gaussians.framed(usable(arrays), photo_focal=focal)
    if not any(len(gaussians) for gaussians, _ in read.values()):
        raise ConfigError(f"{request.source} has no Gaussians.", "Give models that have some.")
    targets = {Path(name): target for name, (_, target) in models.items()}
    if plain:  # files without known photos stay anti-aliased; then all are marked so
        still = any(target.antialiased for target in targets.values())
        targets = {
            path: target_with(antialiased=still, linear_light=target.linear_light)
            for path, target in targets.items()
        }
    matrix = turn(request.from_up or SCENE_UP, request.up or form.up)
    whole, frame = merged([item.of(*read[item.file], matrix) for item in wanted], context)
    return Model(
        arrays=whole.arrays(frame),
        count=sum(len(models[item.file][0]["means"]) for item in wanted),
        target=formats.common_target(targets),
        photo_focal=whole.photo_focal,
        poses=poses,
        matrix=matrix,
    )


def _refuse_too_many(source: Path, models: Sequence[Arrays]) -> None:
    """Raise ConfigError if all listed models, with repetitions, need too much memory."""
    count = sum(len(arrays["means"]) for arrays in models)
    bands = max(arrays["sh"].shape[1] for arrays in models)
    needed, memory = COPIES * 4 * (11 + 3 * bands) * count, machine_memory()
    if needed > memory:
        raise ConfigError(
            f"{source} lists {counted(count, 'Gaussian')} in all, which need "
            f"{needed / 1e9:.1f} GB of memory; this machine has {memory / 1e9:.1f} GB.",
            "List fewer models, or smaller ones.",
        )
