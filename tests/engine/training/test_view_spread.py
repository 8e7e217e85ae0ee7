"""Photos from one side are told from photos all around, and spare what is outside the boxes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.run.presets import PRESETS, in_strategy, preset
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.view_spread import view_spread, with_spared_outside
from tests.poses import look_at

BOX = OrientedBox.axis_aligned("thing", [1, 1, 1], [3, 3, 3])


def arc(degrees: float, elevation: float = 30.0, radius: float = 5.0) -> list[PosedImage]:
    """72 photos, evenly on an arc of that length around the box's centre, which look at it."""
    images, up = [], np.radians(elevation)
    for angle in np.radians((np.arange(72) + 0.5) / 72 * degrees):
        ray = np.cos(up) * np.cos(angle), np.cos(up) * np.sin(angle), np.sin(up)
        eye = BOX.centre + radius * np.array(ray)
        images.append(
            PosedImage(
                name=f"{len(images)}.jpg",
                path=Path(),
                camera=Camera(width=200, height=200, fx=200.0, fy=200.0, cx=100.0, cy=100.0),
                world_to_camera=look_at(eye, BOX.centre),
                point_indices=np.zeros(0, dtype=np.int64),
            )
        )
    return images


@pytest.mark.parametrize("elevation", [0.0, 30.0, 60.0])
def test_a_ring_spreads_by_what_its_elevation_lacks_to_ninety(elevation: float) -> None:
    assert view_spread(arc(360, elevation), BOX) == pytest.approx(90 - elevation)
    assert view_spread(arc(360, elevation, radius=0.01), BOX) == pytest.approx(90 - elevation)


def test_an_arc_spreads_less() -> None:
    spreads = [view_spread(arc(degrees), BOX) for degrees in (1, 60, 120, 240, 360)]
    assert spreads == sorted(spreads)
    assert spreads[0] < 1 and spreads[2] == pytest.approx(29.1, abs=0.1)


def test_few_photos() -> None:
    assert view_spread([], BOX) == 0
    assert view_spread(arc(90)[:1], BOX) == pytest.approx(0, abs=1e-5)


def test_photos_from_one_side_spare_what_is_outside() -> None:
    config = TrainConfig(steps=9, full_every=3, opacity_decay=0.1, outside_spared_spread=45)
    unspared = replace(config, outside_spared_spread=0.0)
    assert with_spared_outside(config, view_spread(arc(360), BOX)) == unspared
    spared = with_spared_outside(config, view_spread(arc(120), BOX))
    assert spared == replace(unspared, outside_spared=1 - 1 / 3)
    assert spared.tells_outside
    more = replace(config, outside_spared=0.9)
    assert with_spared_outside(more, 0).outside_spared == 0.9
    for none in ({"full_every": 1}, {"opacity_decay": 0.0}):
        changes: dict[str, Any] = none
        assert with_spared_outside(replace(config, **changes), 0).outside_spared == 0


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_who_spares_it(name: str) -> None:
    config = in_strategy(preset(name), "joint")
    assert with_spared_outside(config.roi, 0).outside_spared > 0
    for other in (config.scene, in_strategy(config, "independent").roi):
        assert with_spared_outside(other, 0) == other
