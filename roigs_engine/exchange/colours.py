"""Colours of Gaussians that a file has in another space than sRGB."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from ..model.gaussians import SH_C0
from ..model.scene import Float64
from ..photos.profiles import srgb_values
from ..rasterize.reference import sh_basis
from .arrays import Float32
from .transform import sphere

Map = Callable[[Float64], Float64]
"""Colours (N, 3) of a space -> (N, 3) in sRGB, encoded."""

DIRECTIONS = 96  # evenly over the sphere, for at most 16 coefficients
ROWS = 8192  # at once


def encoded(linear: Float64) -> Float64:
    """sRGB's transfer function (IEC 61966-2-1), of light from 0 on; less than none is none."""
    return srgb_values(np.maximum(linear, 0))


def recoloured(sh: Float32, to_srgb: Map = encoded) -> Float32:
    """SH coefficients (N, K, 3) of the same colours after a map, by default from linear light.

    A colour without view dependence is exact: the coefficient of degree 0 is that of its mapped
    colour. Those of higher degrees fit the mapped colours best, by least squares over all
    directions. Programs that blend in linear light blend Gaussians otherwise than in sRGB; no
    coefficients can make up for that.
    """
    base, bands = 0.5 + SH_C0 * sh[:, 0].astype(np.float64), sh.shape[1]
    out = np.zeros(sh.shape, np.float32)
    out[:, 0] = (to_srgb(base) - 0.5) / SH_C0
    if bands == 1:
        return out
    basis = sh_basis(torch.from_numpy(sphere(DIRECTIONS))).numpy()[:, :bands]
    fit = np.linalg.pinv(basis)[1:]
    for start in range(0, len(sh), ROWS):
        rows = slice(start, start + ROWS)
        seen = np.einsum("dk,nkc->ndc", basis, sh[rows].astype(np.float64)) + 0.5
        mapped = to_srgb(seen.reshape(-1, 3)).reshape(seen.shape)
        out[rows, 1:] = np.einsum("kd,ndc->nkc", fit, mapped)
    return out
