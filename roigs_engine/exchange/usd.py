"""OpenUSD's ParticleField3DGaussianSplat, through the package usd-core (26.3 or later)."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import EngineError
from ..formats.files import write_bytes
from ..machine import child_environment, package
from ..model.scene import Float64
from .arrays import Arrays, Float32, joined, logits, opacities, turn, unit_quats
from .libraries import (
    MOST_PARTS,
    MOST_RATIO,
    SMALL,
    NotSupportedError,
    refuse_bomb,
    scratch,
)
from .transform import encoded, moved, recoloured
from .usd_probe import FINE, TOO_DEEP, TOO_LARGE

TITLE = "OpenUSD"
PRIM = "/Gaussians"
ARCS = ("references", "payload", "inheritPaths", "specializes", "variantSetNames", "clips")
"""Fields with which OpenUSD opens other files, or the same prims again and again."""
DEEPEST = 200
"""Most levels of nested prims; at some thousands, OpenUSD's recursion crashes."""
KIND = "ParticleField3DGaussianSplat"
SH = "radiance:sphericalHarmonicsCoefficients"
SPACE = "colorSpace:name"
SRGB = ("srgb_rec709_scene", "srgb_rec709_display", "identity", "raw", "unknown")
"""Names of colour spaces whose colours stay unchanged; other programs also write the second."""
LINEAR = ("lin_rec709_scene", "lin_rec709_display", "lin_rec709")
SETTINGS = {"USDC_USE_ASSET": "1", "TF_ENV_SETTING_ALERTS_ENABLED": "0"}
"""Files are not mapped to memory: for damaged ones, OpenUSD would then print lines of its own."""
DATE = 315_619_200
"""Time of all files in a .usdz, for the same bytes each time: seconds from 1970 to 2 Jan 1980."""


def pxr_modules(*names: str) -> list[Any]:
    """Return modules of OpenUSD; EngineError if it is missing or too old."""
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    if not hasattr(package("pxr.UsdVol", TITLE, "usd-core"), KIND):
        raise EngineError(
            f"This version of usd-core has no {KIND}.", "Install usd-core 26.3 or later."
        )
    return [import_module(f"pxr.{name}") for name in names]


def write_stage(path: Path, name: str, fill: Callable[[Any, Path], None]) -> None:
    """Write a stage with y up, in metres; the path's suffix selects text, binary or packed.

    Args:
        name: name of the layer, which a .usdz has inside.
        fill: called with the new stage, and with a folder for the files that it refers to.
    """
    usd, geom, utils = pxr_modules("Usd", "UsdGeom", "UsdUtils")
    ending = path.suffix.lower()
    packed = ending == ".usdz"
    with scratch(TITLE) as folder:
        made = folder / (f"{name}.usdc" if packed else f"{name}{ending}")
        stage = usd.Stage.CreateNew(os.fspath(made))
        geom.SetStageUpAxis(stage, geom.Tokens.y)
        geom.SetStageMetersPerUnit(stage, 1.0)
        fill(stage, folder)
        stage.GetRootLayer().Save()
        if packed:
            for file in folder.iterdir():  # the package records their times
                os.utime(file, (DATE, DATE))
            whole = made.with_suffix(".usdz")
            utils.CreateNewUsdzPackage(os.fspath(made), os.fspath(whole))
            made = whole
        data = made.read_bytes()
    write_bytes(path, data)


def write(path: Path, arrays: Arrays) -> int:
    """See `FileFormat`. The name's suffix selects text, binary or packed."""
    vol, vt = pxr_modules("UsdVol", "Vt")

    def fill(stage: Any, _folder: Path) -> None:
        prim = getattr(vol, KIND).Define(stage, PRIM)
        stage.SetDefaultPrim(prim.GetPrim())
        means = np.ascontiguousarray(arrays["means"], np.float32)
        scales = np.exp(arrays["log_scales"]).astype(np.float32)
        sh = np.ascontiguousarray(arrays["sh"], np.float32)
        reach = 3 * scales.max(axis=1, keepdims=True)
        extent = np.stack(((means - reach).min(axis=0), (means + reach).max(axis=0)))
        values = {
            "positions": vt.Vec3fArray.FromNumpy(means),
            "scales": vt.Vec3fArray.FromNumpy(scales),
            # Quatf arrays have the imaginary part first.
            "orientations": vt.QuatfArray.FromNumpy(np.roll(unit_quats(arrays), -1, axis=1)),
            "opacities": vt.FloatArray.FromNumpy(opacities(arrays)),
            "radiance:sphericalHarmonicsDegree": int(np.sqrt(sh.shape[1])) - 1,
            "radiance:sphericalHarmonicsCoefficients": vt.Vec3fArray.FromNumpy(sh.reshape(-1, 3)),
            "extent": vt.Vec3fArray.FromNumpy(extent.astype(np.float32)),
        }
        for name, value in values.items():
            prim.GetPrim().GetAttribute(name).Set(value)

    write_stage(path, "model", fill)
    return len(arrays["means"])


def read(path: Path) -> Arrays:
    """See `FileFormat`. All Gaussians of a stage become one model, placed by their prims.

    It is in metres, by the stage's unit. Of an animation, the first frame is read.
    """
    usd, geom = pxr_modules("Usd", "UsdGeom")
    layer, others = _alone(path)
    stage = usd.Stage.Open(layer, usd.Stage.LoadNone)
    prims = [prim for prim in stage.Traverse() if prim.GetTypeName() == KIND]
    if others and not prims:
        raise EngineError(
            f"{path} has its Gaussians in other files, which are not opened.",
            "Make one file of them: usdcat --flatten IN --out OUT.",
        )
    if not prims:
        raise NotSupportedError(f"OpenUSD without {KIND}")
    if len(prims) > MOST_PARTS:
        raise NotSupportedError(f"OpenUSD with {len(prims):,} prims of Gaussians")
    world = np.eye(4)
    if geom.StageHasAuthoredMetersPerUnit(stage):
        world[:3] *= geom.GetStageMetersPerUnit(stage)
    first = usd.TimeCode.EarliestTime()
    found: list[Arrays] = []
    unpacked = 0
    for prim in prims:
        # OpenUSD multiplies rows with matrices.
        place = np.array(geom.Xformable(prim).ComputeLocalToWorldTransform(first)).T
        found.append(moved(_gaussians(prim), world @ place))
        # A file may have the same numbers for any number of prims.
        unpacked += sum(rows.nbytes for rows in found[-1].values())
        refuse_bomb(path.stat().st_size, unpacked)
    return joined(found)


def frame(path: Path) -> Float64:
    """Return (3, 3) from a file's axes to those of its format: from the stage's upAxis to y."""
    usd, geom = pxr_modules("Usd", "UsdGeom")
    stage = usd.Stage.Open(_alone(path)[0], usd.Stage.LoadNone)
    return turn(str(geom.GetStageUpAxis(stage)).lower(), "y")[:3, :3]


def _gaussians(prim: Any) -> Arrays:
    """Return the Gaussians of a prim, in its own frame; float attributes are preferred to half."""
    first = pxr_modules("Usd")[0].TimeCode.EarliestTime()

    def numbers(name: str, width: int) -> Float32:
        values = (prim.GetAttribute(kind).Get(first) for kind in (name, f"{name}h"))
        found = next((value for value in values if value is not None and len(value)), None)
        if found is None and name == SH:
            raise NotSupportedError(f"{KIND} without {name}")
        if found is None:
            raise ValueError(f"no {name}")
        return np.array(found, np.float32).reshape(-1, width)

    means, alpha = numbers("positions", 3), numbers("opacities", 1)[:, 0]
    return {
        "means": means,
        "quats": np.roll(numbers("orientations", 4), 1, axis=1),  # arrays have xyzw
        "log_scales": np.log(np.maximum(numbers("scales", 3), 1e-30)),
        "logit_opacities": logits(alpha),
        "sh": _in_srgb(prim, numbers(SH, 3).reshape(len(means), -1, 3)[:, :16]),
    }


def _in_srgb(prim: Any, sh: Float32) -> Float32:
    """Convert SH to sRGB from the colour space of the coefficients, the prim or one above it.

    If none is named, they are in sRGB: trainers use it, though OpenUSD's own default is linear.
    """
    gf, vt = pxr_modules("Gf", "Vt")
    attribute = prim.GetAttribute(SH if prim.GetAttribute(SH).HasValue() else f"{SH}h")
    name, place = str(attribute.GetColorSpace() or ""), prim
    while not name and not place.IsPseudoRoot():  # ColorSpaceAPI knows fewer names
        name = str((place.HasAttribute(SPACE) and place.GetAttribute(SPACE).Get()) or "")
        place = place.GetParent()
    if not name or name in SRGB:
        return sh
    if name in LINEAR:
        return recoloured(sh)
    source, light = gf.ColorSpace(name), gf.ColorSpace(LINEAR[0])
    if not gf.ColorSpace.IsValid(name) or source.IsData():
        raise NotSupportedError(f"the colour space {name:.40}")

    def to_srgb(colours: Float64) -> Float64:
        span = vt.FloatArray.FromNumpy(colours.astype(np.float32).reshape(-1))
        source.ConvertRGBSpan(light, span)
        return encoded(np.array(span, np.float64).reshape(-1, 3))

    return recoloured(sh, to_srgb)


def _alone(path: Path) -> tuple[Any, bool]:
    """Return a file's layer without its references to other content, and whether it had any.

    A small file may refer to a pipe, any file of the computer, or itself a billion times.
    """
    (sdf,) = pxr_modules("Sdf")
    _refuse_crash(path)
    layer = sdf.Layer.OpenAsAnonymous(os.fspath(path))
    if layer is None:
        raise ValueError("there is no layer in it")
    others = bool(layer.subLayerPaths)
    layer.subLayerPaths.clear()

    def cut(place: Any) -> None:
        nonlocal others
        spec = layer.GetObjectAtPath(place)
        for name in filter(spec.HasInfo, ARCS) if spec else ():
            spec.ClearInfo(name)
            others = True

    layer.Traverse(sdf.Path.absoluteRootPath, cut)
    return layer, others


def _refuse_crash(path: Path) -> None:
    """Raise ValueError for a file that would end this process, or fill its memory.

    A separate process opens it first.
    """
    limit = max(SMALL, MOST_RATIO * path.stat().st_size)
    command = [sys.executable, "-m", f"{__package__}.usd_probe", str(path), str(limit)]
    command.append(str(DEEPEST))
    # Each of many threads would take address space.
    env = child_environment() | {"PXR_WORK_THREAD_LIMIT": "1", "MALLOC_ARENA_MAX": "2"}
    env["PYTHONPATH"] = os.pathsep.join(filter(os.path.isabs, sys.path))
    with subprocess.Popen(
        command,
        env=env,
        stdin=subprocess.PIPE,  # the child ends when this process does
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches this process alone
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    ) as child:
        code = child.wait()
    if code == TOO_DEEP:
        raise ValueError(f"its prims are nested more than {DEEPEST} deep")
    if code == TOO_LARGE:
        raise ValueError("it would unpack to far more than it holds")
    if code != FINE:
        raise ValueError("OpenUSD cannot open it")
