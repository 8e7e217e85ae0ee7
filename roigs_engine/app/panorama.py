"""Draws panoramas of a scene's light, in linear light, for the world of another program."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, EngineError, RoiError
from ..formats import run_files
from ..formats.events import StageStarted
from ..formats.files import read_record
from ..formats.gravity import gravity_alignment
from ..formats.others import refuse_other_companion
from ..model.roi import OrientedBox, roi_from_dict
from ..requests.models import Panorama
from .inputs import on_device, use_threads
from .instances import LIST, InstanceRecord, drawable_model, read_list, refuse_much
from .outputs import Result, refuse_inputs, refuse_run_files
from .run_scene import folder_of_model, poses_of_run

if TYPE_CHECKING:
    from ..lighting.highlights import Surfaces
    from ..lighting.panorama import Panorama as Light
    from ..lighting.sides import Shading
    from ..model.scene import Float64

STAGE = "panorama"
ENDING = ".hdr"
MOST_PLACES = 40_000  # on the background mesh


def draw_panorama(request: Panorama, context: Context = QUIET) -> Result:
    """Draw the light that arrives at each point; the text reports the brightness of highlights.

    EngineError: an input cannot be used, or nothing is seen from a point.
    """
    files = _files(request)
    refuse_run_files(request.out)
    folder = request.run or folder_of_model(request.model)
    boxes = _boxes(folder, request.without)
    records, to_upright = _models(request, folder, context)
    inputs = [request.options_file, request.model, *(Path(each.file) for each in records)]
    refuse_inputs([*files, *map(run_files.mirrored, files)], inputs)
    for file in files:
        refuse_other_companion(file, run_files.mirrored(file))
    use_threads(request.threads)
    context = on_device(context, request.device)

    from ..lighting.highlights import brightness
    from ..lighting.panorama import left_out, panorama
    from ..lighting.sides import shading
    from ..rasterize.image_files import save_light

    read = {
        name: drawable_model(Path(name), context.warn, context.check_cancelled)
        for name in dict.fromkeys(each.file for each in records)
    }
    models = [each.of(*read[each.file]) for each in records]
    # A list may place models of other runs, in which the boxes' places are something else.
    listed = request.model.suffix.lower() == LIST
    of_run = [
        not listed or folder_of_model(Path(each.file)) == folder.absolute() for each in records
    ]
    surfaces, objects = _background(folder, records, context), _objects(folder, records, context)
    context.emit(StageStarted(stage=STAGE, total=len(files)))
    lines, started = [], time.monotonic()
    for step, (at, file) in enumerate(zip(request.at, files, strict=True), start=1):
        place = to_upright[:3, :3] @ at + to_upright[:3, 3]
        seen = [
            left_out(model, boxes if own else (), place, request.near)
            for model, own in zip(models, of_run, strict=True)
        ]
        light = panorama(seen, place, request.width // 2, context)
        given = request.highlights, request.unseen
        factors = brightness(light, place, surfaces, *given)
        shone = shading(light, factors, place, objects, surfaces, given=given != (None, None))
        save_light(file, shone.light)
        # A mirror would show light from where no photo looked as a bright cap.
        mirrored = light.brightened(shone.factors.highlights)
        save_light(run_files.mirrored(file), mirrored, companion=True)
        lines.append(_line(at, light, shone, given))
        context.info(lines[-1])
        context.progress(STAGE, step, len(files), started)
    names = [STAGE] if len(files) == 1 else [f"{STAGE}-{k + 1}" for k in range(len(files))]
    return Result(files=dict(zip(names, files, strict=True))).with_places(*lines)


def _files(request: Panorama) -> list[Path]:
    """Return the files to write, one for each point."""
    out = request.out
    if out.suffix.lower() != ENDING:
        raise ConfigError(f"{out} is no {ENDING} file.", f"Use {out.with_suffix(ENDING)}.")
    if len(request.at) == 1:
        return [out]
    return [out.with_name(f"{out.stem}-{k + 1}{out.suffix}") for k in range(len(request.at))]


def _boxes(folder: Path, names: tuple[str, ...]) -> list[OrientedBox]:
    """Return a run folder's boxes of these names; RoiError for an unknown name."""
    if not names:
        return []
    record = read_record(folder / run_files.MANIFEST).get("rois")
    known = [roi_from_dict(each) for each in record] if isinstance(record, list) else []
    found = {roi.name: roi for roi in known}
    for name in names:
        if name not in found:
            there = f"The boxes are: {', '.join(found)}." if found else "Give its run with --run."
            raise RoiError(f"{folder} has no box '{name}'.", there)
    return [found[name] for name in dict.fromkeys(names)]


def _models(
    request: Panorama, folder: Path, context: Context
) -> tuple[list[InstanceRecord], Float64]:
    """Return the models in a world with z up, and (4, 4) from the points' frame to it."""
    upright = np.eye(4)
    if request.model.suffix.lower() == LIST:
        records, _ = read_list(request.model, context)
        refuse_much(records)
        return records, upright
    poses = poses_of_run(folder)
    if poses is None:
        context.warn(
            f"No photos determine the up direction of {request.model.name}: its z axis is used."
        )
    else:
        upright[:3, :3] = gravity_alignment(poses)
    return [InstanceRecord(str(request.model), upright)], upright


def _background(folder: Path, records: list[InstanceRecord], context: Context) -> Surfaces | None:
    """Places on the run's background mesh; None: there is no mesh."""
    path = folder / run_files.FINE / f"{run_files.SURROUNDINGS}.glb"
    return _surfaces(path, folder, records, context) if path.is_file() else None


def _objects(folder: Path, records: list[InstanceRecord], context: Context) -> list[Surfaces]:
    """Sample places on the meshes of the run's boxes; unreadable meshes are left out."""
    found = []
    for path in sorted((folder / run_files.FINE).glob("*.glb")):
        if path.stem == run_files.SURROUNDINGS:
            continue
        try:
            found.append(_surfaces(path, folder, records, context))
        except EngineError as error:
            context.warn(f"The shading of {path.stem} is not used: {error}")
    return found


def _surfaces(
    path: Path, folder: Path, records: list[InstanceRecord], context: Context
) -> Surfaces:
    """Places on a mesh of a run, in the world of the models."""
    import torch

    from ..lighting.highlights import Surfaces
    from ..rasterize.light import to_linear
    from ..surface.files import sampled_surface

    own = [each for each in records if folder_of_model(Path(each.file)) == folder.absolute()]
    matrix = (own or records)[0].matrix
    places, normals, colours = sampled_surface(path, MOST_PLACES, context)
    turned = normals @ np.linalg.inv(matrix[:3, :3])
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
    return Surfaces(
        places=places @ matrix[:3, :3].T + matrix[:3, 3],
        normals=turned,
        colours=to_linear(torch.from_numpy(colours)).numpy(),
    )


def _line(
    at: tuple[float, ...],
    light: Light,
    shone: Shading,
    given: tuple[float | None, float | None],
) -> str:
    """Describe the light at a point, with the factors of light that photos cannot show."""
    place = ", ".join(f"{value:.4g}" for value in at)
    factors, sides, white = shone.factors, shone.sides, shone.white
    how = "estimated from the scene's shading" if factors.told else "a typical value"
    parts = (
        (f"clipped light ({light.clipped.mean():.2%})", factors.highlights, given[0]),
        ("unseen light above", factors.unseen, given[1]),
    )
    said = [
        f"{what} is made {factor:.3g} times brighter, {how if asked is None else 'as asked'}"
        for what, factor, asked in parts
        if asked is not None or factor != 1
    ]
    if (most := float(sides.max() / sides.min())) > 1:
        said.append(
            f"one side is made {most:.2g} times brighter than the other, estimated from the boxes"
        )
    if white > 1:
        said.append(
            f"all light is made {white:.3g} times brighter, so that no surface is whiter than white"
        )
    bright = "; ".join(said) or "no light is added"
    return f"Light at {place}: {light.seen:.0%} of all directions are seen; {bright}."
