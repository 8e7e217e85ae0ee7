"""Photos from one side are told from photos all around, and spare what is outside the boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import ConfigError
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.run.presets import PRESETS, in_strategy, preset
from roigs_engine.training.config import PlannedViews, TrainConfig
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay, view_spread
from tests.engine.settings import without
from tests.poses import look_at

BOX = OrientedBox.between("thing", [1, 1, 1], [3, 3, 3])


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


def decay(config: TrainConfig, degrees: float) -> OpacityDecay:
    """The decay of a stage with photos on an arc of that length."""
    views = PlannedViews(images=(), rois=[BOX], seen=lambda roi: arc(degrees))
    return config.planned(views).of(OpacityDecay)


def test_photos_from_one_side_spare_what_is_outside() -> None:
    masks = MaskedSteps(full_every=4)
    config = TrainConfig(steps=9, mechanisms=(masks, OpacityDecay(share=0.1, one_sided=45)))
    assert decay(config, 360) == OpacityDecay(share=0.1)
    assert decay(config, 120) == OpacityDecay(share=0.1, outside_share=0.025)
    less = config.using(OpacityDecay(share=0.1, one_sided=45, outside_share=0.01))
    assert decay(less, 120).outside_share == 0.01
    with pytest.raises(ConfigError, match="opacity_decay needs masked_steps"):
        without(config, MaskedSteps)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_who_spares_it(name: str) -> None:
    config = in_strategy(preset(name), "joint")
    assert config.roi.of(OpacityDecay).one_sided > 0
    assert config.scene.of(OpacityDecay).one_sided == 0
    assert in_strategy(config, "independent").roi.get(OpacityDecay) is None
