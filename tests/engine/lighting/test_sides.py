"""The side from which more light comes than a panorama shows, and how much light that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roigs_engine.lighting.highlights import Brightness, Surfaces
from roigs_engine.lighting.panorama import Panorama, directions, solid_angles
from roigs_engine.lighting.sides import WHITE, _coarse, gain, shading, whiteness

HEIGHT = 32
EVEN = np.ones((HEIGHT, 2 * HEIGHT, 3), np.float32)
FAR = np.full((HEIGHT, 2 * HEIGHT), 4.0, np.float32)
SIDE = np.array([0.2, -0.8, 0.5])
HERE = np.zeros(3)


def lit(normals: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(N, 3) what white surfaces show."""
    flux = (light * solid_angles(HEIGHT)[..., None]).reshape(-1, 3) / np.pi
    return np.maximum(normals @ directions(HEIGHT).reshape(-1, 3).T, 0) @ flux


def ball(light: np.ndarray, *, at: float = 0.5, white: float = 0.6) -> Surfaces:
    """A ball with a pattern of three colours, as it is under a light."""
    random = np.random.default_rng(4)
    normals = random.normal(size=(8000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedos = white * random.choice([0.1, 0.5, 1.0], 8000)[:, None]
    places = 0.1 * normals + (at, 0, 0)
    return Surfaces(places=places, normals=normals, colours=albedos * lit(normals, light))


def side_above() -> np.ndarray:
    """(H, 2 H) a gain with a side, above the horizon."""
    ways = directions(HEIGHT)
    return np.where(ways[..., 2] > 0, np.exp(ways @ SIDE), 1.0)


def test_shading_tells_the_side_whatever_the_colours() -> None:
    factors = side_above()
    light = (EVEN * factors[..., None]).astype(np.float32)
    found = gain(EVEN, FAR, HERE, [ball(light), ball(light, at=-0.5, white=0.2)])
    above = directions(HEIGHT)[..., 2] > 0.25
    likeness = np.corrcoef(np.log(found[above]), np.log(factors[above]))[0, 1]
    assert likeness > 0.98
    there, true = (np.ptp(np.log(each[above])) for each in (found, factors))
    ratio = there / true
    assert ratio == pytest.approx(0.85, abs=0.15)  # usual places have no side: it is held back
    normals = ball(EVEN).normals
    before, after = lit(normals, EVEN), lit(normals, EVEN * found[..., None])
    assert np.log(after / before).mean() == pytest.approx(0, abs=0.02)  # it is not brighter


def test_what_is_below_the_horizon_is_as_bright_as_it_is_shown() -> None:
    light = (EVEN * side_above()[..., None]).astype(np.float32)
    found = gain(EVEN, FAR, HERE, [ball(light)])
    assert (found[HEIGHT // 2 :] == 1).all()
    assert found[: HEIGHT // 2].max() > 1.5


def test_light_of_a_side_is_neutral() -> None:
    red = (EVEN * (1.0, 0.5, 0.25)).astype(np.float32)
    grey = (EVEN * red.mean() * (6 * side_above() - 5).clip(0.05)[..., None]).astype(np.float32)
    panorama = under_a_ceiling(1.0)[0]
    panorama = replace(panorama, shown=red, guessed=0 * red, unseen=0 * panorama.unseen)
    found = shading(panorama, Brightness(), HERE, [ball(grey)], None, given=True)
    added = (found.light - red)[found.sides > 1.1]
    assert len(added) and np.ptp(added, axis=1).max() < 1e-5
    less = (found.light / red)[found.sides < 1]
    assert len(less) and np.ptp(less, axis=1).max() < 1e-5


def test_a_light_without_a_side_stays() -> None:
    found = gain(EVEN, FAR, HERE, [ball(EVEN)])
    assert found.max() / found.min() < 1.05


@pytest.mark.parametrize("dark", [(0.0, 0.0, 1.0), (0.3, -1.0, 0.2), (0.0, 0.6, -0.8)])
def test_surfaces_that_no_light_reaches_tell_nothing(dark: tuple[float, float, float]) -> None:
    """A light that is black on one side: what faces that has no ratio to keep."""
    random = np.random.default_rng(5)
    found = ball(EVEN)
    noisy = found.colours * random.uniform(0.05, 1, (8000, 1))
    black = np.where((directions(HEIGHT) @ dark)[..., None] > -0.4, 0.0, EVEN).astype(np.float32)
    for objects in ([found], [replace(found, colours=noisy)], [ball(black)]):
        factors = gain(black, FAR, HERE, objects)
        assert np.isfinite(factors).all() and (factors[HEIGHT // 2 :] == 1).all()


def test_objects_that_are_far_away_tell_nothing() -> None:
    light = (EVEN * side_above()[..., None]).astype(np.float32)
    for objects in ([], [ball(light, at=3.0)]):
        assert (gain(EVEN, FAR, HERE, objects) == 1).all()


def test_what_would_be_whiter_than_white_asks_for_more_light() -> None:
    dim = (EVEN / 8).astype(np.float32)
    probe = ball(dim, white=WHITE)
    assert whiteness(dim, [probe]) == pytest.approx(1.0, abs=0.03)
    for factor in (2, 4):  # the panorama shows that much less than there is
        shown = (dim / factor).astype(np.float32)
        assert whiteness(shown, [probe]) == pytest.approx(factor, rel=0.03)
        grey = ball(dim, white=0.2)
        assert whiteness(shown, [grey, probe]) == pytest.approx(factor, rel=0.03)


def test_grey_things_and_clipped_ones_ask_for_none() -> None:
    dim = (EVEN / 8).astype(np.float32)
    clipped = ball(dim, white=WHITE)
    clipped.colours[::3] = 1.0  # a window
    assert whiteness(dim, [ball(dim, white=0.3)]) == 1.0
    assert whiteness(dim, [clipped]) == pytest.approx(1.0, abs=0.03)
    assert whiteness(dim, []) == whiteness(0 * dim, [clipped]) == 1.0
    clipped.colours[:] = 1.0
    assert whiteness(dim, [clipped]) == 1.0


def under_a_ceiling(factor: float) -> tuple[Panorama, np.ndarray]:
    """A dim room whose upper third no photo shows, and its light if that is brighter."""
    hole = np.zeros((HEIGHT, 2 * HEIGHT), np.float32)
    hole[: HEIGHT // 3] = 1
    dim = (EVEN / 16).astype(np.float32)
    panorama = Panorama(
        shown=dim * (1 - hole[..., None]),
        guessed=dim * hole[..., None],
        unseen=hole,
        clipped=hole > 1,
        seen=0.8,
        distance=FAR,
    )
    return panorama, panorama.brightened(1.0, factor)


def test_light_that_is_missing_comes_from_where_photos_do_not_look() -> None:
    panorama, light = under_a_ceiling(6.0)
    probe = ball(light, white=WHITE)
    found = shading(panorama, Brightness(unseen=2.0), HERE, [probe], None, given=False)
    assert found.factors.unseen == pytest.approx(6.0, rel=0.05) and found.white == 1
    assert whiteness(found.light, [probe]) == pytest.approx(1.0, abs=0.02)
    assert found.light.mean() == pytest.approx(light.mean(), rel=0.03)


def test_given_factors_stay_and_without_a_hole_all_is_brighter() -> None:
    panorama, light = under_a_ceiling(6.0)
    probe = ball(light, white=WHITE)
    kept = shading(panorama, Brightness(unseen=2.0), HERE, [probe], None, given=True)
    assert kept.factors.unseen == 2 and kept.white == 1
    whole = replace(
        panorama,
        shown=panorama.light,
        guessed=0 * panorama.guessed,
        unseen=0 * panorama.unseen,
    )
    scaled = shading(whole, Brightness(), HERE, [], probe, given=False)
    assert scaled.factors == Brightness() and scaled.white > 1.5
    assert whiteness(scaled.light, [probe]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("width", [*range(64, 2100, 2), 3000, 8190])
def test_pictures_of_any_width_are_seen_coarsely(width: int) -> None:
    ways, flux = _coarse(np.ones((width // 2, width, 3), np.float32))
    assert len(ways) == len(flux)
    assert flux.sum() == pytest.approx(4 * np.pi, rel=0.15)
