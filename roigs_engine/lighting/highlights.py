"""Estimates the brightness of lamps, windows and sky, which photos clip or do not show.

It finds two factors: one for clipped light, and one for unseen light above the horizon, where lamps
and the sky are. Surfaces of the scene serve as light probes of unknown albedo. Surfaces of one
colour that face different ways usually have the same albedo, so the ratio of their brightness is
the ratio of their irradiance. The light is assumed to be far away, like an environment map (Debevec
1998). Two assumptions fix the scale: hardly any albedo is above 0.95, and most are about 0.45.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..model.scene import Float64
from .panorama import Panorama, directions, solid_angles

MOST = 100.0  # largest factor, relative to white, or to the surroundings of unseen parts
STEPS = 33  # factors that are tried, from 1 to `MOST`
ALBEDO, SPREAD = 0.45, 0.5  # of a usual place: median, and standard deviation of its logarithm
ALIKE = 0.05  # cost of a difference of the two factors, relative to one of the whole light
WHITE, STRICT = 0.95, 0.1  # hardly any albedo is above; standard deviation of its logarithm there
SHARE = 95  # percentile of the surfaces' albedos that this applies to
LEAST_CLIPPED, LEAST_UNSEEN = 1e-4, 1e-2  # share of all directions; parts below have no factor
ROWS = 64  # about how many rows of the panorama light is summed over, at most
SAMPLES, NEIGHBOURS = 3000, 40
COLOUR = 0.06  # surfaces of one colour differ by less, in logarithms of ratios of channels
TURNED = 0.5  # largest cosine between the normals of a pair
NOISE = 0.35  # of the logarithm of a ratio of brightness: shadows, other materials (Cauchy)
INDEPENDENT = 50  # number of independent surfaces of a scene
FEWEST = 500  # least number of pairs
SECTORS = 8  # around the point; a factor that depends on one of them counts as undetermined
SURE = np.log(2.0)  # largest standard error of a factor's logarithm
DARKEST, BRIGHTEST = 0.01, 0.85  # linear light of surfaces; others are noisy, or clipped
BEHIND = 1.1  # of the visible distance; surfaces farther away are hidden


@dataclass(frozen=True, kw_only=True, eq=False)
class Surfaces:
    """Places (N, 3) on surfaces of the scene, their unit normals, and linear colours."""

    places: Float64
    normals: Float64
    colours: Float64


@dataclass(frozen=True, kw_only=True)
class Brightness:
    """Factors for the parts of a panorama's light.

    Attributes:
        highlights: factor for clipped light.
        unseen: factor for light from directions above the horizon that no photo shows.
        told: whether the scene's shading determines the factors; else they are typical values.
    """

    highlights: float = 1.0
    unseen: float = 1.0
    told: bool = False


def brightness(
    panorama: Panorama,
    place: Float64,
    surfaces: Surfaces | None = None,
    highlights: float | None = None,
    unseen: float | None = None,
) -> Brightness:
    """Estimate the factors of a panorama.

    Args:
        place: (3,) the panorama's point, in the world of the surfaces.
        surfaces: surfaces of the scene; None if unknown.
        highlights, unseen: given factors, which are kept; None: estimated.
    """
    grids = [
        _grid(given, enough=_share(where) > least)
        for where, given, least in (
            (panorama.clipped, highlights, LEAST_CLIPPED),
            (panorama.unseen, unseen, LEAST_UNSEEN),
        )
    ]
    if len(grids[0]) * len(grids[1]) == 1:
        return Brightness(highlights=float(grids[0][0]), unseen=float(grids[1][0]))
    tried = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 2)
    parts = panorama.parts(ROWS)
    told = None if surfaces is None else _told(panorama, place, surfaces, tried)
    found = _usual(parts, tried) if told is None else told
    return Brightness(highlights=float(found[0]), unseen=float(found[1]), told=told is not None)


def _grid(given: float | None, *, enough: bool) -> Float64:
    """Return the factors to try: many, or only the given one."""
    if given is None and enough:
        return np.geomspace(1, MOST, STEPS)
    return np.array([1.0 if given is None else given])


def _share(where: NDArray[Any]) -> float:
    """Return the share of all directions of a part (H, 2 H) of a panorama, 0 to 1 in each pixel."""
    return float((where * solid_angles(len(where))).sum() / (4 * np.pi))


def _usual(parts: Float64, tried: Float64) -> Float64:
    """Return the factors with which surfaces reflect the usual share of the light.

    The reflected light is the light that is seen and not clipped. If both factors are unknown,
    similar factors are preferred, because both belong to the same kind of light.
    """
    flux = (parts * solid_angles(parts.shape[1])).sum(axis=(1, 2))
    total = flux[0] + tried @ flux[1:]
    off = np.abs(np.log(np.maximum(flux[0], 1e-12) / (ALBEDO * total)))
    apart = np.abs(np.log(tried[:, 0] / tried[:, 1])) * ((np.ptp(tried, axis=0) > 0).all())
    return np.asarray(tried[np.argmin(off + ALIKE * apart)])


def _told(panorama: Panorama, place: Float64, surfaces: Surfaces, tried: Float64) -> Float64 | None:
    """Return the factors by the surfaces' shading; None if it does not determine them."""
    rows = _usable(panorama, place, surfaces)
    if len(rows) < NEIGHBOURS:
        return None
    places, normals, colours = (
        values[rows] for values in (surfaces.places, surfaces.normals, surfaces.colours)
    )
    bright = np.log(colours.mean(axis=1))
    a, b = _pairs(normals, colours)
    if len(a) < FEWEST:
        return None
    light = _irradiance(panorama, normals)
    around = np.arctan2(*(places - place).T[1::-1])
    sector = ((around / (2 * np.pi) + 0.5) * SECTORS).astype(int).clip(0, SECTORS - 1)
    losses = np.zeros((len(tried), SECTORS))
    known = np.zeros(len(tried))
    for k, (highlights, unseen) in enumerate(tried):
        given = np.log(light @ (1, highlights, unseen))
        off = (bright[a] - bright[b]) - (given[a] - given[b])
        losses[k] = np.bincount(sector[a], np.log1p((off / NOISE) ** 2), SECTORS)
        albedos = np.log(np.pi) + bright - given
        known[k] = 0.5 * ((np.median(albedos) - np.log(ALBEDO)) / SPREAD) ** 2
        over = max(0.0, float(np.percentile(albedos, SHARE)) - np.log(WHITE))
        known[k] += 0.5 * (over / STRICT) ** 2
    counts = np.bincount(sector[a], minlength=SECTORS)
    without = [
        tried[np.argmin((losses.sum(axis=1) - losses[:, k]) / max(len(a) - counts[k], 1))]
        for k in range(SECTORS)
    ]
    error = np.log(without).std(axis=0) * np.sqrt(SECTORS - 1)
    found = np.asarray(tried[np.argmin(INDEPENDENT * losses.sum(axis=1) / len(a) + known)])
    ends = (found == MOST) & (np.ptp(tried, axis=0) > 0)  # then it hardly matters
    return None if ends.any() or (error > SURE).any() else found


def _usable(panorama: Panorama, place: Float64, surfaces: Surfaces) -> Float64:
    """Return rows of surfaces that are seen from the place, and neither dark nor clipped."""
    height = len(panorama.distance)
    away = surfaces.places - place
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    x = (0.5 - np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)) * 2 * height
    y = (0.5 - np.arcsin(np.clip(away[:, 2] / distance, -1, 1)) / np.pi) * height
    seen = panorama.distance[
        y.astype(int).clip(0, height - 1), x.astype(int).clip(0, 2 * height - 1)
    ]
    usable = (distance < BEHIND * seen) & (surfaces.colours.mean(axis=1) > DARKEST)
    usable &= (surfaces.colours.max(axis=1) < BRIGHTEST) & (surfaces.colours.min(axis=1) > 0)
    rows = np.flatnonzero(usable)
    return np.asarray(np.random.default_rng(0).permutation(rows)[:SAMPLES])


def _pairs(normals: Float64, colours: Float64) -> tuple[Float64, Float64]:
    """Return rows of pairs of surfaces with the same colour that face different ways."""
    tints = np.log(colours[:, (0, 2)] / colours[:, 1:2])
    away, near = cKDTree(tints).query(tints, k=min(NEIGHBOURS, len(tints)), p=np.inf)
    a = np.repeat(np.arange(len(tints)), near.shape[1])
    b = near.ravel()
    kept = (a < b) & (away.ravel() < COLOUR) & ((normals[a] * normals[b]).sum(axis=1) < TURNED)
    return a[kept], b[kept]


def _irradiance(panorama: Panorama, normals: Float64) -> Float64:
    """Return the irradiance (N, 3) at these normals from the three parts of the light."""
    parts = panorama.parts(ROWS)
    parts = parts * solid_angles(parts.shape[1])
    ways = directions(parts.shape[1]).reshape(-1, 3)
    flux = parts.reshape(3, -1).T
    step = 500  # normals at once: 33 MB
    found = [
        np.clip(normals[first : first + step] @ ways.T, 0, None) @ flux
        for first in range(0, len(normals), step)
    ]
    return np.asarray(np.maximum(np.concatenate(found), 1e-12))
