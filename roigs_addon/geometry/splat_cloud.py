"""Gaussians as arrays for drawing. Numpy only, no bpy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..shared import EngineError, drawable, splat_ply, targets

Float32 = NDArray[np.float32]

SH_C0 = 0.28209479177387814
"""The spherical harmonic of degree 0."""

LEAST = 1e-30
"""Replaces a scale of 0, which has no logarithm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatCloud:
    """N Gaussians as they are drawn, float32; K = 1, 4, 9 or 16 SH coefficients per colour.

    Attributes:
        means: (N, 3) centres.
        quats: (N, 4) unit quaternions, wxyz.
        scales: (N, 3) standard deviations.
        opacities: (N,) 0 to 1.
        sh: (N, K, 3) SH coefficients; a colour is max(0, 0.5 + sum of sh * basis), sRGB.
        target: renderer that they are made for. Others draw them differently.
        photo_focal: focal length of the training photos, pixels; None if unknown.
    """

    means: Float32
    quats: Float32
    scales: Float32
    opacities: Float32
    sh: Float32
    target: targets.Target = targets.PLAIN
    photo_focal: float | None = None

    def __len__(self) -> int:
        return len(self.means)

    @property
    def antialiased(self) -> bool:
        """Whether they are drawn with anti-aliasing."""
        return self.target.antialiased


def read_splats(path: str | Path) -> SplatCloud:
    """Read a PLY of Gaussians, without those that cannot be drawn (`drawable`).

    Raises:
        ValueError: the file cannot be read, see `splat_ply.read_ply`; its text is one line.
    """
    try:
        stored = drawable.usable(splat_ply.read_ply(path))
        made = splat_ply.made_of(path)
    except EngineError as error:
        raise ValueError(str(error)) from error
    quats = stored["quats"]
    opacities = 1 / (1 + np.exp(-stored["logit_opacities"]))
    return SplatCloud(
        means=stored["means"].astype(np.float32, copy=False),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32, copy=False),
        scales=np.exp(stored["log_scales"]),
        opacities=opacities.astype(np.float32, copy=False),
        sh=stored["sh"].astype(np.float32, copy=False),
        **made,
    )


def write_splats(path: Path, cloud: SplatCloud, *, durable: bool = True) -> None:
    """Write a PLY of Gaussians; raises EngineError or OSError if that fails.

    `durable`: wait until it is on the disk.
    """
    opacities = np.clip(cloud.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    logits = np.log(opacities / (1 - opacities))
    arrays = {
        "means": cloud.means,
        "quats": cloud.quats,
        "log_scales": np.log(np.maximum(cloud.scales, LEAST)),
        "logit_opacities": logits.astype(np.float32),
        "sh": cloud.sh,
    }
    focal = cloud.photo_focal
    splat_ply.write_ply(path, arrays, cloud.target, photo_focal=focal, durable=durable)
