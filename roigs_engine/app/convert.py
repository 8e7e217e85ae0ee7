"""Converts files of Gaussians to other formats; rotates, crops and merges them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..exchange import formats, gltf
from ..exchange.arrays import turn
from ..formats.files import size_read
from ..formats.text import counted
from ..requests.models import Convert
from .conversion.axes import SCENE_UP, turned, warn_of_axes
from .conversion.models import listed, single
from .conversion.page import compared, page_extras, refuse_page_options
from .conversion.reading import read_arrays, refuse_own_inputs, shortened
from .inputs import boxes_of
from .instances import LIST, refuse_beyond_memory
from .outputs import Result, refuse_run_files
from .run_scene import levelled_run

if TYPE_CHECKING:
    from ..exchange.formats import FileFormat
    from ..formats.targets import Target

STREAMED = "lod-meta.json"


def convert(request: Convert, context: Context = QUIET) -> Result:
    """Read the models, merge them, and write the result; EngineError for unusable input."""
    refuse_run_files(request.out)
    if request.source.suffix.lower() == ".glb" and gltf.is_mesh(request.source):
        return _mesh(request, context)
    if request.out.name == STREAMED:
        refuse_page_options(request, plain=False)
        return _write_streamed(request, context)
    form = formats.writable(request.out)
    plain = request.plain or not form.keeps_antialiased
    refuse_page_options(request, plain=plain)
    if request.source.suffix.lower() == LIST and not formats.is_named(request.source):
        model = listed(request, form, context, plain=plain)
    else:
        model = single(request, form, context, plain=plain)
    arrays = shortened(model.arrays, request)
    context.check_cancelled()
    if model.target.antialiased and plain:
        _say_photos_unknown(form, context)
    if model.target.linear_light and not form.keeps_target:
        _warn_of_light(model.target, form, context)
    if form.suffix == formats.PAGE:
        extras = page_extras(request, compared(request, form.up, model, context), model, context)
        written = formats.write(request.out, arrays, target=model.target, extras=extras)
    else:
        check = context.check_cancelled
        focal = model.photo_focal
        written = formats.write(request.out, arrays, check, target=model.target, photo_focal=focal)
    left = f" ({model.count - written:,} left out)" if model.count > written else ""
    size = request.out.stat().st_size / 1e6
    text = f"{counted(written, 'Gaussian')}{left}, {size:.1f} MB in {request.out}"
    return Result(files={"result": request.out}, text=text)


def _mesh(request: Convert, context: Context) -> Result:
    """Convert a surface, or another textured mesh with y up."""
    from ..surface.files import UP, convert_mesh

    refuse_own_inputs(request, request.source)
    if request.out.suffix.lower() not in UP:
        raise ConfigError(
            f"{request.source} is a mesh, which {request.out.name} cannot contain.",
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
            f"{option} is for Gaussians only; {request.source} is a mesh.", "Leave it out."
        )
    refuse_page_options(request, plain=False)
    faces = convert_mesh(request.source, request.out, request.up, context)
    size = request.out.stat().st_size / 1e6
    text = f"{counted(faces, 'face')}, {size:.1f} MB in {request.out}"
    return Result(files={"result": request.out}, text=text)


def _write_streamed(request: Convert, context: Context) -> Result:
    from ..exchange import streamed_sog
    from ..formats.levels import read_ladders

    folder = levelled_run(request.source)
    if boxes_of(request, required=False):
        raise ConfigError(f"{STREAMED} contains a whole result.", "Leave out the boxes.")
    if request.plain:
        raise ConfigError(f"{STREAMED} records how its Gaussians are drawn.", "Leave out --plain.")
    before = request.from_up or SCENE_UP
    matrix = turn(before, request.up or SCENE_UP)
    if request.from_up is None:
        warn_of_axes(request.source, before, context)
    ladders = read_ladders(folder)
    plys = [folder / level.ply for ladder in ladders.values() for level in ladder.levels]
    refuse_beyond_memory(
        2 * sum(map(size_read, plys)),
        f"The {len(plys):,} levels of detail of {folder} need",
        "Make fewer levels (`levels`), or use a machine with more memory.",
    )
    parts, files = [], []
    for ladder in ladders.values():
        levels = []
        for level in ladder.levels:
            file = folder / level.ply
            refuse_own_inputs(request, file)
            context.check_cancelled()
            arrays = read_arrays(file, context)
            levels.append(shortened(turned(arrays, matrix), request))
            files.append(file)
        parts.append(levels)
    target = formats.common_target({file: formats.target_of(file) for file in files})
    if target.linear_light:
        _warn_of_light(target, formats.format_of(Path("meta.json")), context)
    check, smooth = context.check_cancelled, target.antialiased
    written = streamed_sog.write(request.out, parts, check, antialiased=smooth)
    text = f"{counted(written, 'Gaussian')} in levels of detail in {request.out.parent}"
    return Result(files={"result": request.out}, text=text)


def _warn_of_light(target: Target, form: FileFormat, context: Context) -> None:
    """Warn that a format cannot record blending in linear light."""
    context.warn(
        f"{form.title} cannot record that these Gaussians are made for {target.title}: other "
        "programs will show them too dark. Adapt them to these programs first (`adapt`)."
    )


def _say_photos_unknown(form: FileFormat, context: Context) -> None:
    """Refuse to write anti-aliased Gaussians as plain ones; warn if the format cannot record it."""
    why = "their training photos are unknown"
    if form.keeps_antialiased:
        raise ConfigError(
            f"--plain cannot change these Gaussians, as {why}.",
            "Give their scene's folder with --scene, or leave out --plain.",
        )
    context.warn(
        f"{form.title} cannot record that these Gaussians are anti-aliased, and {why}: other "
        "programs will show fine ones too thick. Give their scene's folder with --scene, or "
        "write .ply, .spz, .sog or .html."
    )
