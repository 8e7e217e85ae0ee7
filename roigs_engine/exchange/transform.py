"""Transforms of whole models: affine maps, merging, colours, removal of anti-aliasing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..formats.drawable import usable
from ..formats.events import StageStarted
from ..formats.targets import target_with
from ..model.gaussians import SH_C0, Gaussians
from ..model.local_frame import LocalFrame
from ..model.scene import Float64, PosedImage
from ..photos.profiles import srgb_values
from ..rasterize.inputs import NEAR, blur_of
from ..rasterize.instances import Instance, posed, principal_axes
from ..rasterize.reference import drawn_share, jacobian, sh_basis
from .arrays import Arrays, Float32, flaw

STAGE, MANY = "models", 100
"""Name of the stage of merging, and the number of models from which it reports progress."""


def merged(models: Sequence[Instance], context: Context = QUIET) -> tuple[Gaussians, LocalFrame]:
    """Merge placed models with at least one Gaussian in the world; return the model, its frame."""
    bands = max(model.gaussians.sh.shape[1] for model in models)
    parts: list[Gaussians] = []
    started = time.monotonic()
    if len(models) >= MANY:
        context.emit(StageStarted(stage=STAGE, total=len(models)))
    for model in models:
        context.check_cancelled()
        if parts and len(parts) % MANY == 0:
            context.progress(STAGE, len(parts), len(models), started)
        sh = turned_sh(model.gaussians.sh, model.from_frame[:3, :3])
        padded = torch.nn.functional.pad(sh, (0, 0, 0, bands - sh.shape[1]))
        parts.append(posed(model, model.from_frame, padded))
    whole = Gaussians.concatenate(parts)
    centres = whole.means.numpy()
    frame = LocalFrame.of_centres(centres)
    means = torch.from_numpy(frame.points(centres).astype(np.float32))
    log_scales = whole.log_scales + float(np.log(frame.scale))
    return replace(whole, means=means, log_scales=log_scales), frame


PLACES = 12  # decimals of the fit; the rest depends on the number of threads
DIRECTIONS = 2048  # evenly over the sphere; 16 coefficients are fitted to them


def turned_sh(sh: Tensor, linear: Float64) -> Tensor:
    """SH coefficients of colours after a linear map of the space around them.

    A Gaussian that showed a colour in direction d then shows it in direction linear @ d. Rotations,
    reflections and uniform scales turn spherical harmonics up to a degree into others of this
    degree, so the result is exact for them. A map that stretches or shears bends directions: then
    the coefficients are the best fit, by least squares over all directions.

    `sh` is (N, K, 3) with K = 1, 4, 9 or 16; `linear` (3, 3) is invertible.
    """
    turn = _turn(sh.shape[1], np.asarray(linear, np.float64).tobytes())
    return torch.einsum("jk,nkc->njc", turn, sh)


@lru_cache(maxsize=64)
def _turn(bands: int, linear: bytes) -> Tensor:
    """Return the matrix (K, K) of `turned_sh`; `linear` are the bytes of its (3, 3) matrix."""
    after = sphere(DIRECTIONS)
    before: Float64 = np.linalg.solve(np.frombuffer(linear).reshape(3, 3), after.T).T
    before = before.astype(np.float64)
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    basis, wanted = (sh_basis(torch.from_numpy(d)).numpy()[:, :bands] for d in (after, before))
    turn = np.linalg.lstsq(basis, wanted, rcond=None)[0].round(PLACES) + 0.0  # no -0
    return torch.from_numpy(turn.astype(np.float32))


@cache
def sphere(count: int) -> Float64:
    """Return (count, 3) unit vectors, evenly spread: a Fibonacci lattice."""
    steps = np.arange(count) + 0.5
    z = 1 - 2 * steps / count
    angle = np.pi * (1 + np.sqrt(5)) * steps
    around = np.sqrt(1 - z**2)
    return np.column_stack((around * np.cos(angle), around * np.sin(angle), z))


FLATTEST = 1e-9  # least determinant of a matrix, of 1 for the same size in all directions


def moved(arrays: Arrays, matrix: Float64) -> Arrays:
    """Transform Gaussians by a (4, 4) matrix; the identity returns them unchanged.

    ValueError if the arrays are no Gaussians, or if the matrix is not affine or flattens them.
    """
    if (matrix == np.eye(4)).all():
        return arrays
    if problem := flaw(arrays):
        raise ValueError(problem)
    linear = matrix[:3, :3]
    if not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise ValueError("its transform is none of space")
    if abs(np.linalg.det(linear)) <= FLATTEST * np.linalg.norm(linear, axis=0).prod():
        raise ValueError("its transform flattens the Gaussians")
    arrays = usable(arrays)
    if not len(arrays["means"]):
        return arrays
    gaussians, frame = Gaussians.framed(arrays)
    model, frame = merged([Instance(gaussians=gaussians, frame=frame, matrix=matrix)])
    return model.arrays(frame)


Map = Callable[[Float64], Float64]
"""Colours (N, 3) of a space -> (N, 3) in sRGB, encoded."""

FITTED = 96  # evenly over the sphere, for at most 16 coefficients
ROWS = 8192  # at once


def encoded(linear: Float64) -> Float64:
    """Apply sRGB's transfer function (IEC 61966-2-1) to linear light; negative values become 0."""
    return srgb_values(np.maximum(linear, 0))


def recoloured(sh: Float32, to_srgb: Map = encoded) -> Float32:
    """Return SH coefficients (N, K, 3) of the colours after a map, by default from linear light.

    A colour without view dependence is exact: the coefficient of degree 0 is that of its mapped
    colour. Those of higher degrees are the best fit to the mapped colours, by least squares over
    all directions. Blending in linear light differs from blending in sRGB; no coefficients can
    compensate for that.
    """
    base, bands = 0.5 + SH_C0 * sh[:, 0].astype(np.float64), sh.shape[1]
    out = np.zeros(sh.shape, np.float32)
    out[:, 0] = (to_srgb(base) - 0.5) / SH_C0
    if bands == 1:
        return out
    basis = sh_basis(torch.from_numpy(sphere(FITTED))).numpy()[:, :bands]
    fit = np.linalg.pinv(basis)[1:]
    for start in range(0, len(sh), ROWS):
        rows = slice(start, start + ROWS)
        seen = np.einsum("dk,nkc->ndc", basis, sh[rows].astype(np.float64)) + 0.5
        mapped = to_srgb(seen.reshape(-1, 3)).reshape(seen.shape)
        out[rows, 1:] = np.einsum("kd,ndc->nkc", fit, mapped)
    return out


@torch.no_grad()
def without_antialiasing(model: Gaussians, images: Sequence[PosedImage]) -> Gaussians:
    """Adapt an anti-aliased model to viewers that draw without anti-aliasing.

    Such a viewer enlarges Gaussians that are smaller than a pixel, but keeps their opacity. Then no
    stored opacity is right from every distance. Here it becomes the mean opacity at which the
    photos show the Gaussian: the model is right from about where it was photographed, somewhat too
    thick from farther away and too faint from nearer.

    Args:
        model: on the CPU.
        images: the photos' cameras, in the model's frame. A Gaussian that none of them shows stays
            as it is.
    """
    axes = principal_axes(model)
    total, count = torch.zeros(len(model)), torch.zeros(len(model))
    for image in images:
        camera = image.camera
        pose = torch.as_tensor(image.world_to_camera, dtype=torch.float32)
        matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32)
        centres = model.means @ pose[:3, :3].T + pose[:3, 3]
        place = centres[:, :2] / centres[:, 2:] * matrix.diagonal()[:2] + matrix[:2, 2]
        size = torch.tensor([camera.width, camera.height])
        rows = ((centres[:, 2] > NEAR) & (place > 0).all(1) & (place < size).all(1)).nonzero()[:, 0]
        projected = jacobian(centres[rows], matrix, camera.width, camera.height) @ pose[:3, :3]
        total[rows] += drawn_share(projected @ axes[rows], blur_of(1.0, antialiased=True))
        count[rows] += 1
    share = torch.where(count > 0, total / count.clamp(min=1), 1.0)
    opacity = model.logit_opacities.sigmoid() * share
    target = target_with(antialiased=False, linear_light=model.target.linear_light)
    return replace(model, logit_opacities=torch.logit(opacity, eps=1e-6), target=target)
