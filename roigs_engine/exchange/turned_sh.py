"""Turns view-dependent colours with their Gaussians."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..model.scene import Float64
from ..rasterize.reference import sh_basis

PLACES = 12  # decimals of the fit; the rest depends on the number of threads
DIRECTIONS = 2048  # evenly over the sphere; 16 coefficients are fitted to them


def turned_sh(sh: Tensor, linear: Float64) -> Tensor:
    """SH coefficients of colours after a linear map of the space around them.

    A Gaussian that showed a colour in direction d then shows it in direction linear @ d. Spherical
    harmonics up to a degree stay such under rotations and reflections, so for these, uniform scales
    included, the result is exact. A map that stretches or shears bends directions: then the
    coefficients are those that fit best, by least squares over all directions.

    Args:
        sh: (N, K, 3), K = 1, 4, 9 or 16.
        linear: (3, 3), invertible.
    """
    bands = sh.shape[1]
    after = _sphere(DIRECTIONS)
    before: Float64 = np.linalg.solve(linear, after.T).T.astype(np.float64)
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    basis, wanted = (_basis(directions)[:, :bands] for directions in (after, before))
    turn = np.linalg.lstsq(basis, wanted, rcond=None)[0].round(PLACES) + 0.0  # no -0
    return torch.einsum("jk,nkc->njc", torch.from_numpy(turn.astype(np.float32)), sh)


def _basis(directions: Float64) -> Float64:
    found: Float64 = sh_basis(torch.from_numpy(directions)).numpy()
    return found


def _sphere(count: int) -> Float64:
    """(count, 3) unit vectors, evenly spread: a Fibonacci lattice."""
    steps = np.arange(count) + 0.5
    z = 1 - 2 * steps / count
    angle = np.pi * (1 + np.sqrt(5)) * steps
    around = np.sqrt(1 - z**2)
    return np.column_stack((around * np.cos(angle), around * np.sin(angle), z))
