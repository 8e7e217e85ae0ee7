""".splat: 32 bytes for each Gaussian, without view-dependent colours (antimatter15/splat)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..formats.files import atomic_write
from ..model.gaussians import SH_C0
from .arrays import Arrays, Float32, opacities, unit_quats

ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)]
)


def write(path: Path, arrays: Arrays) -> None:
    """Write Gaussians, the largest and most opaque first, as viewers that stream the file want it.

    Raises:
        RunFolderError: the file cannot be written.
    """
    rows = np.empty(len(arrays["means"]), ROW)
    alpha = opacities(arrays)
    rows["mean"], rows["scale"] = arrays["means"], np.exp(arrays["log_scales"])
    rows["colour"][:, :3] = _bytes(0.5 + SH_C0 * arrays["sh"][:, 0].astype(np.float32))
    rows["colour"][:, 3] = _bytes(alpha)
    rows["rotation"] = np.clip(np.round(unit_quats(arrays) * 128 + 128), 0, 255)
    order = np.argsort(-arrays["log_scales"].sum(axis=1) - np.log(alpha + 1e-6), kind="stable")
    with atomic_write(path) as file:
        file.write(rows[order].tobytes())


def _bytes(values: Float32) -> Float32:
    rounded: Float32 = np.clip(np.round(values * 255), 0, 255)
    return rounded
