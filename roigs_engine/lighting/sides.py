"""Estimates the main direction of a scene's light, and its total amount, from the shading.

A panorama does not show a lamp out of view, or a window that photos show too dark. But such a light
is visible on one side of the objects. An object with a mesh is a light probe. We assume that its
bright surfaces are equally white in all directions, so the ratio of their brightness is the ratio
of their irradiance (a white patch for each direction, separately for each object). The light from
direction d is multiplied by exp(a · d), the smoothest gain with a direction. The vector `a` is the
best fit to these ratios. This applies only above the horizon, where lamps, windows and the sky are.
Surfaces below it are lit themselves, and photos show their brightness.

Shading does not determine the amount of light: a white object in half of the light looks like a
grey one. But nothing is much whiter than white paint or paper. If bright surfaces would have to be
whiter than that, there must be more light (the white patch of Retinex, Land and McCann 1971). This
light is added where photos cannot show it, or everywhere if that is not enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, least_squares

from ..model.scene import Float64
from ..rasterize.instances import NOTHING
from .highlights import BRIGHTEST, MOST, Brightness, Surfaces
from .panorama import RAMP, Float32, Panorama, directions, solid_angles

NEAR = 0.5  # objects nearer than this, in median distances above the horizon, have the same light
WAYS, CONE = 64, 0.85  # directions; least cosine between a direction and normals that face it
BRIGHT = 98  # percentile of the brightness, or albedo, of surfaces that face one way
SAMPLES = 4000  # surfaces of a probe whose albedo is used
WHITE = 0.8  # albedo of white paint and paper
FEWEST = 0.005  # least share of an object's surface that faces a direction
NOISE, INDEPENDENT = 0.25, 12  # of logarithms of ratios; number of independent directions
USUAL = 1.4  # standard deviation of `a`: usual places have no strong side
ROWS = 32  # about how many rows of the picture are used
HALVINGS = 8  # of the range of a factor's logarithm in the search for it, to 1 %


@dataclass(frozen=True, kw_only=True, eq=False)
class Shading:
    """The light of a panorama, estimated from the scene's shading.

    Attributes:
        light: (H, 2 H, 3) linear.
        factors: factors of clipped and of unseen light, applied first.
        sides: (H, 2 H) factors of the light's side, applied next.
        white: factor of all light, applied last.
    """

    light: Float32
    factors: Brightness
    sides: Float32
    white: float = 1.0


def shading(
    panorama: Panorama,
    factors: Brightness,
    place: Float64,
    objects: Sequence[Surfaces],
    surroundings: Surfaces | None,
    *,
    given: bool,
) -> Shading:
    """Estimate the light with its side, and enough of it that nothing is whiter than white.

    Args:
        factors: factors that were found or given.
        place: (3,) the panorama's point, in the world of the surfaces.
        given: whether the factors are given; then they and the amount of light stay as they are.
    """
    probes = [*objects, surroundings] if surroundings else objects
    near = _near(panorama.distance, place, objects)

    def lit(more: float) -> Shading:
        raised = replace(
            factors, highlights=more * factors.highlights, unseen=more * factors.unseen
        )
        light = panorama.brightened(raised.highlights, raised.unseen)
        sides = _gain(light, near)
        return Shading(light=_sided(light, sides), factors=raised, sides=sides)

    found = lit(1.0)
    white = 1.0 if given else whiteness(found.light, probes)
    if white == 1:
        return found
    low, high, most = 0.0, np.log(MOST), lit(MOST)
    if whiteness(most.light, probes) > 1:  # the light is missing elsewhere
        return replace(found, light=found.light * np.float32(white), white=white)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        tried = lit(float(np.exp(middle)))
        if whiteness(tried.light, probes) > 1:
            low = middle
        else:
            high, most = middle, tried
    return most


def gain(light: Float32, distance: Float32, place: Float64, objects: Sequence[Surfaces]) -> Float32:
    """Return factors (H, 2 H) of the side for a panorama's light (H, 2 H, 3).

    The mean light on the objects does not change. All factors are 1 if no object is near.

    Args:
        light: light at the place, in the world of the objects.
        distance: (H, 2 H) distance of what is seen.
        place: (3,)
        objects: places, normals and colours of each.
    """
    return _gain(light, _near(distance, place, objects))


def _sided(light: Float32, sides: Float32) -> Float32:
    """Multiply a light (H, W, 3) by its side; added light is neutral, like unseen light."""
    less, more = np.minimum(sides, 1)[..., None], np.maximum(sides - 1, 0)
    return np.asarray(less * light + (more * light.mean(axis=-1))[..., None], np.float32)


def _above(ways: Float64) -> Float64:
    """Return the height of directions (..., 3): 0 up to the horizon, 1 from `RAMP` degrees."""
    return np.asarray(np.clip(np.degrees(np.arcsin(np.clip(ways[..., 2], -1, 1))) / RAMP, 0, 1))


Told = list[tuple[Float64, Float64]]
"""Result of `_told` for each object."""


def _near(distance: Float32, place: Float64, objects: Sequence[Surfaces]) -> Told:
    """Return the brightness of the objects near the place; see `_told`."""
    above = distance[: len(distance) // 2]  # where light comes from; tables below are near
    seen_at = above[above < NOTHING]
    reach = NEAR * float(np.median(seen_at)) if len(seen_at) else 0.0
    near = [
        each
        for each in objects
        if len(each.places) and np.linalg.norm(np.median(each.places, axis=0) - place) < reach
    ]
    return [_told(each) for each in near]


def _gain(light: Float32, found: Told) -> Float32:
    """See `gain`."""
    ways, flux = _coarse(light)
    side = _fitted(found, ways, flux)
    if not side.any():
        return np.ones(light.shape[:2], np.float32)
    facing = np.concatenate([normals for normals, _ in found])
    seen, high = np.maximum(facing @ ways.T, 0), _above(ways)
    parts = (1 + 0 * high, 1 - high, high * np.exp(ways @ side))
    levels = np.stack([seen @ (flux * part) for part in parts])
    whole, low, lit = levels[:, levels[0] > 0]  # surfaces without light do not count

    def brighter(kept: float) -> float:
        return float(np.mean(np.log((low + np.exp(kept) * lit) / whole))) if len(whole) else 0.0

    most = float(np.linalg.norm(side))  # with this logarithm, all light is brighter, or darker
    matters = brighter(-most) < 0 < brighter(most)  # false without light above the horizon
    kept = np.exp(brentq(brighter, -most, most)) if matters else 1.0
    every = directions(len(light))
    above = _above(every)
    return np.asarray(1 - above + above * kept * np.exp(every @ side), np.float32)


def whiteness(light: Float32, probes: Sequence[Surfaces]) -> float:
    """Return the least factor for the light, 1 or more, with which no probe is whiter than white.

    Args:
        light: (H, 2 H, 3) in the world of the probes, with its side.
        probes: the surroundings, and the objects.
    """
    ways, flux = _coarse(light)
    if not flux.sum() > 0:
        return 1.0
    whitest = np.log(WHITE)
    for probe in probes:
        kept = np.flatnonzero(probe.colours.max(axis=1) < BRIGHTEST)  # a window is no white object
        kept = np.random.default_rng(0).permutation(kept)[:SAMPLES]
        normals, bright = probe.normals[kept], probe.colours[kept].mean(axis=1)
        given = np.maximum(normals @ ways.T, 0) @ flux / np.pi
        _, albedos = _brightest(normals, bright / np.maximum(given, 1e-12))
        if len(albedos):
            whitest = max(whitest, float(albedos.mean()))
    return float(np.exp(whitest) / WHITE)


def _told(surfaces: Surfaces) -> tuple[Float64, Float64]:
    """Return ways (N, 3) that enough of an object faces, and logarithms of its brightness there."""
    return _brightest(surfaces.normals, surfaces.colours.mean(axis=1))


def _brightest(normals: Float64, values: Float64) -> tuple[Float64, Float64]:
    """Return ways (N, 3) that enough normals face, and logarithms of the largest values there."""
    if not len(normals):
        return np.zeros((0, 3)), np.zeros(0)
    k = np.arange(WAYS) + 0.5
    z, turn = 1 - 2 * k / WAYS, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    ways = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    facing = normals @ ways.T > CONE
    kept = facing.mean(axis=0) > FEWEST
    found = [np.percentile(values[facing[:, k]], BRIGHT) for k in np.flatnonzero(kept)]
    return ways[kept], np.log(np.maximum(found, 1e-3))


def _coarse(light: Float32) -> tuple[Float64, Float64]:
    """Return ways (N, 3) of fewer pixels, and brightness times solid angle (N,) from there."""
    step = max(1, len(light) // ROWS)
    height = len(light) // step
    width = 2 * height
    flux = light.mean(axis=-1) * solid_angles(len(light))
    cut = flux[: height * step, : width * step].reshape(height, step, width, step)
    return directions(height).reshape(-1, 3), cut.sum(axis=(1, 3)).ravel().astype(float)


def _fitted(found: Sequence[tuple[Float64, Float64]], ways: Float64, flux: Float64) -> Float64:
    """Fit the vector `a` (3,); each object's brightness has a free factor: how white it is."""
    seen = [np.maximum(normals @ ways.T, 0) for normals, _ in found if len(normals)]
    values = [bright for normals, bright in found if len(normals)]
    if not seen or not flux.sum() > 0:
        return np.zeros(3)

    high = _above(ways)

    def off(side: Float64) -> Float64:
        lit = flux * (1 - high + high * np.exp(ways @ side))
        parts = [side / USUAL]
        for each, bright in zip(seen, values, strict=True):
            rest = np.log(np.maximum(each @ lit, 1e-12)) - bright
            weight = np.sqrt(min(1.0, INDEPENDENT / len(bright))) / NOISE
            parts.append(weight * (rest - rest.mean()))
        return np.concatenate(parts)

    return np.asarray(least_squares(off, np.zeros(3)).x)
