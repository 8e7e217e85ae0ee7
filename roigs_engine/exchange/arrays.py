"""Gaussians as file formats take them: arrays in the form of `formats.splat_ply`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..formats.splat_ply import Floats

Float32 = NDArray[np.float32]
Arrays = Mapping[str, Floats]
"""`means` (N, 3), `quats` (N, 4), `log_scales` (N, 3), `logit_opacities` (N,), `sh` (N, K, 3)."""


def unit_quats(arrays: Arrays) -> Float32:
    """(N, 4) rotations of length 1, wxyz."""
    quats = arrays["quats"].astype(np.float64)
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    unit: Float32 = (quats / np.where(lengths > 0, lengths, 1)).astype(np.float32)
    return unit


def opacities(arrays: Arrays) -> Float32:
    """(N,) from 0 to 1."""
    with np.errstate(over="ignore"):
        values: Float32 = (1 / (1 + np.exp(-arrays["logit_opacities"]))).astype(np.float32)
    return values


def logits(opacity: Float32) -> Float32:
    """The inverse of `opacities`, for what files round to 0 or 1 too."""
    inside = np.clip(opacity.astype(np.float64), 1e-6, 1 - 1e-6)
    values: Float32 = np.log(inside / (1 - inside)).astype(np.float32)
    return values


def usable(arrays: Arrays) -> Arrays:
    """Without Gaussians that have a number that is not finite, or a rotation of length zero."""
    good = np.linalg.norm(arrays["quats"], axis=1) > 0
    for values in arrays.values():
        good &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
    return arrays if good.all() else {name: values[good] for name, values in arrays.items()}
