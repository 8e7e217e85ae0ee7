"""OpenUSD's ParticleField3DGaussianSplat, through the package usd-core (26.3 or later)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import EngineError
from ..formats.files import write_bytes
from .arrays import Arrays, logits, opacities, turn, unit_quats
from .libraries import package, scratch
from .transform import moved

TITLE = "OpenUSD"
PRIM = "/Gaussians"
ARCS = ("references", "payload", "inheritPaths", "specializes", "variantSetNames", "clips")
"""What makes OpenUSD open other files, or the same prims again and again."""
KIND = "ParticleField3DGaussianSplat"


def _modules() -> tuple[Any, Any, Any, Any, Any]:
    names = ("Usd", "UsdGeom", "UsdVol", "Vt", "UsdUtils")
    usd, geom, vol, vt, utils = (package(f"pxr.{name}", TITLE, "usd-core") for name in names)
    if not hasattr(vol, KIND):
        raise EngineError(
            f"This version of usd-core has no {KIND}.", "Install usd-core 26.3 or later."
        )
    return usd, geom, vol, vt, utils


def write(path: Path, arrays: Arrays) -> int:
    """See `FileFormat`. The name's end says whether as text, binary or packed."""
    usd, geom, vol, vt, utils = _modules()
    packed = path.suffix.lower() == ".usdz"
    with scratch(TITLE) as folder:
        made = folder / ("model.usdc" if packed else f"model{path.suffix.lower()}")
        stage = usd.Stage.CreateNew(os.fspath(made))
        geom.SetStageUpAxis(stage, geom.Tokens.y)
        geom.SetStageMetersPerUnit(stage, 1.0)
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
            # Quatf arrays take the imaginary part first.
            "orientations": vt.QuatfArray.FromNumpy(np.roll(unit_quats(arrays), -1, axis=1)),
            "opacities": vt.FloatArray.FromNumpy(opacities(arrays)),
            "radiance:sphericalHarmonicsDegree": int(np.sqrt(sh.shape[1])) - 1,
            "radiance:sphericalHarmonicsCoefficients": vt.Vec3fArray.FromNumpy(sh.reshape(-1, 3)),
            "extent": vt.Vec3fArray.FromNumpy(extent.astype(np.float32)),
        }
        for name, value in values.items():
            prim.GetPrim().GetAttribute(name).Set(value)
        stage.GetRootLayer().Save()
        if packed:
            whole = made.with_suffix(".usdz")
            utils.CreateNewUsdzPackage(os.fspath(made), os.fspath(whole))
            made = whole
        data = made.read_bytes()
    write_bytes(path, data)
    return len(means)


def read(path: Path) -> Arrays:
    """See `FileFormat`: the Gaussians of a stage with one such prim, where it has them, y up."""
    usd, geom, *_ = _modules()
    layer, others = _alone(path)
    stage = usd.Stage.Open(layer, usd.Stage.LoadNone)
    prims = [prim for prim in stage.Traverse() if prim.GetTypeName() == KIND]
    if others and not prims:
        raise EngineError(
            f"{path} has its Gaussians in other files, which are not opened.",
            "Make one file of them: usdcat --flatten IN --out OUT.",
        )
    if len(prims) != 1:
        raise ValueError(f"{len(prims)} prims of Gaussians, not one")

    def get(name: str) -> Any:
        return prims[0].GetAttribute(name).Get()

    means = np.array(get("positions"), np.float32)
    bands = (int(get("radiance:sphericalHarmonicsDegree")) + 1) ** 2
    sh = np.array(get("radiance:sphericalHarmonicsCoefficients"), np.float32)
    quats = [(q.GetReal(), *q.GetImaginary()) for q in get("orientations")]
    arrays = {
        "means": means,
        "quats": np.array(quats, np.float32).reshape(-1, 4),
        "log_scales": np.log(np.maximum(np.array(get("scales"), np.float32), 1e-30)),
        "logit_opacities": logits(np.array(get("opacities"), np.float32)),
        "sh": sh.reshape(len(means), bands, 3),
    }
    # OpenUSD multiplies rows with matrices.
    place = np.array(geom.Xformable(prims[0]).ComputeLocalToWorldTransform(0.0)).T
    up = str(geom.GetStageUpAxis(stage)).lower()
    return moved(arrays, turn(up, "y") @ place)


def _alone(path: Path) -> tuple[Any, bool]:
    """The layer of a file without what it takes from elsewhere; whether it took anything.

    A small file may name a pipe, any file of the computer, or itself a billion times.
    """
    sdf = package("pxr.Sdf", TITLE, "usd-core")
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
