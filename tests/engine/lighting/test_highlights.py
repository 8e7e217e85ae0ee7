"""Brightness of lamps, from the shading of surfaces whose light is known."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.lighting.highlights import Surfaces, brightness
from roigs_engine.lighting.panorama import Panorama, panorama, solid_angles
from tests.engine.clouds import placed
from tests.engine.lighting.room import GREY, ball_around, room

HEIGHT = 64
LAMP = np.array([0.0, 0.6, 0.8])
LIGHT = ((GREY + 0.055) / 1.055) ** 2.4  # linear, of the room
ANGLE = 0.12  # steradians of the lamp; its rim is blurred, and not white
PLACE = np.zeros(3)


@pytest.fixture(scope="module")
def lit() -> Panorama:
    """A grey room with a lamp that photos show white."""
    found = panorama([placed(room({tuple(LAMP): (1.0, 1.0, 1.0)}))], PLACE, HEIGHT)
    assert (found.clipped * solid_angles(HEIGHT)).sum() == pytest.approx(ANGLE, rel=0.1)
    return found


def surfaces(
    factor: float,
    *,
    way: np.ndarray = LAMP,
    angle: float = ANGLE,
    tints: int = 6,
    count: int = 4000,
) -> Surfaces:
    """Matt things in the room, lit by a lamp `factor` times brighter than white.

    Args:
        way, angle: of the lamp.
        tints: how many materials; those of one colour have one albedo.
    """
    random = np.random.default_rng(0)
    normals = ball_around(count)
    of = random.integers(tints, size=count)
    colour = random.uniform(0.5, 1.0, (tints, 3)) * random.uniform(0.3, 0.9, (tints, 1))
    light = np.pi * LIGHT + angle * (factor - LIGHT) * np.clip(normals @ way, 0, None)
    noise = np.exp(random.normal(0, 0.1, (count, 1)))
    values = colour[of] / np.pi * light[:, None] * noise
    return Surfaces(places=random.uniform(-1.5, 1.5, (count, 3)), normals=normals, colours=values)


@pytest.mark.parametrize("factor", [3.0, 8.0, 20.0])
def test_the_shading_tells_the_lamp(lit: Panorama, factor: float) -> None:
    found = brightness(lit, PLACE, surfaces(factor))
    assert found.told and found.unseen == 1
    assert found.highlights == pytest.approx(factor, rel=0.3)


def test_the_shading_tells_what_no_photo_shows() -> None:
    """A hole above, which was filled with the grey around it."""
    up = np.array([0.0, 0, 1])
    dark = panorama([placed(room(hole=(0, 0, 1)))], PLACE, HEIGHT)
    angle = 2 * np.pi * (1 - np.cos(np.radians(27)))  # the rim of the hole is half covered
    found = brightness(dark, PLACE, surfaces(6 * LIGHT, way=up, angle=angle))
    assert found.told and found.highlights == 1
    assert found.unseen == pytest.approx(6.0, rel=0.4)


def test_without_pairs_of_one_colour_the_place_is_usual(lit: Panorama) -> None:
    lonely = surfaces(8.0, tints=4000)
    few = Surfaces(places=lonely.places, normals=np.tile(LAMP, (4000, 1)), colours=lonely.colours)
    for given in (few, None):
        found = brightness(lit, PLACE, given)
        assert not found.told and 1 < found.highlights <= 100
    # The room gives back 45 % of all light: the lamp has the rest.
    shown = LIGHT * (4 * np.pi - ANGLE)
    assert found.highlights * ANGLE == pytest.approx(shown * (1 / 0.45 - 1), rel=0.25)


def test_what_is_asked_for_is_kept(lit: Panorama) -> None:
    found = brightness(lit, PLACE, surfaces(8.0), highlights=2.0)
    assert found.highlights == 2 and found.unseen == 1


def test_a_room_without_lamps_and_holes_stays_as_it_is() -> None:
    grey = panorama([placed(room())], PLACE, HEIGHT)
    found = brightness(grey, PLACE, surfaces(8.0))
    assert (found.highlights, found.unseen) == (1, 1)
