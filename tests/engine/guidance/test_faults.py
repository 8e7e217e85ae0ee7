"""Photos with a fault are named with the reason; good ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roigs_engine.guidance.faults import (
    BLURRED,
    EXPOSED,
    FOCUS,
    PLACED,
    UNREADABLE,
    PhotoFault,
    photo_faults,
)
from roigs_engine.guidance.figures import exposure_spread
from roigs_engine.guidance.known import KnownBox, known_box
from roigs_engine.guidance.photo_quality import PhotoQuality
from tests.engine.guidance.ball import BOX, ball_scene


@pytest.fixture(scope="module")
def good() -> KnownBox:
    known = known_box(ball_scene(), BOX, look=False)
    count = len(known.map.images)
    quality = PhotoQuality(
        sharpness=np.linspace(0.75, 1, count),
        overall=np.ones(count),
        exposure=np.linspace(-0.3, 0.3, count),
        texture=np.zeros(len(known.map.patches)),
        unreadable=(),
    )
    return replace(known, quality=quality)


def with_values(known: KnownBox, **values: tuple[int, float]) -> KnownBox:
    """The box with one photo's measure changed: name -> (photo, value)."""
    assert known.quality is not None
    changed = {}
    for name, (column, value) in values.items():
        changed[name] = getattr(known.quality, name).copy()
        changed[name][column] = value
    return replace(known, quality=replace(known.quality, **changed))


def one(known: KnownBox) -> PhotoFault:
    (fault,) = photo_faults(known)
    return fault


def test_good_photos_have_no_fault_and_without_a_look_nothing_is_said(good: KnownBox) -> None:
    assert photo_faults(good) == ()
    assert photo_faults(replace(good, quality=None)) == ()


def test_a_blurred_photo_and_one_out_of_focus_at_the_object_differ(good: KnownBox) -> None:
    name = good.map.images[4].name
    blurred = one(with_values(good, sharpness=(4, 0.6), overall=(4, 0.6)))
    assert (blurred.photo, blurred.reason) == (name, BLURRED) and "60%" in blurred.text
    assert one(with_values(good, sharpness=(4, 0.6))).reason == FOCUS


def test_the_spread_of_exposures_is_that_of_the_photos_that_tell(good: KnownBox) -> None:
    assert exposure_spread(good.quality) == pytest.approx(0.6)
    assert exposure_spread(with_values(good, exposure=(7, 1.7)).quality) == pytest.approx(2.0)
    assert exposure_spread(with_values(good, exposure=(0, np.nan)).quality) < 0.6
    assert exposure_spread(None) == 0


def test_an_odd_exposure_is_named_but_not_where_all_differ(good: KnownBox) -> None:
    fault = one(with_values(good, exposure=(7, -1.7)))
    assert fault.reason == EXPOSED and "1.7 stops darker" in fault.text
    assert good.quality is not None
    all_differ = replace(good.quality, exposure=6 * good.quality.exposure)
    assert photo_faults(replace(good, quality=all_differ)) == ()
    two_groups = 0.1 * good.quality.exposure
    two_groups[: len(two_groups) // 4] += 1.6
    drift = replace(good.quality, exposure=two_groups)
    assert photo_faults(replace(good, quality=drift)) == ()


def test_numbers_that_are_missing_are_no_fault(good: KnownBox) -> None:
    nan = float("nan")
    assert photo_faults(with_values(good, sharpness=(2, nan), exposure=(2, nan))) == ()


def test_a_camera_on_few_points_may_be_misplaced(good: KnownBox) -> None:
    images = list(good.map.images)
    images[3] = replace(images[3], point_indices=images[3].point_indices[:12])
    fault = one(replace(good, map=replace(good.map, images=tuple(images))))
    assert (fault.photo, fault.reason) == (images[3].name, PLACED) and "12 points" in fault.text
    bare = [replace(image, point_indices=np.zeros(0, np.int64)) for image in images]
    assert photo_faults(replace(good, map=replace(good.map, images=tuple(bare)))) == ()


def test_an_unreadable_photo_is_named(good: KnownBox) -> None:
    assert good.quality is not None
    broken = replace(good, quality=replace(good.quality, unreadable=("01.png",)))
    assert one(broken).reason == UNREADABLE


def test_the_worst_photo_is_the_first(good: KnownBox) -> None:
    """By the share of its information that is left: 0.1² < 2⁻³ < 0.6²."""
    assert good.quality is not None
    sharp, light = good.quality.sharpness.copy(), np.zeros_like(good.quality.exposure)
    sharp[[1, 5]], light[3] = (0.6, 0.1), -3.0
    known = replace(
        good, quality=replace(good.quality, sharpness=sharp, exposure=light, unreadable=("z.png",))
    )
    names = [image.name for image in good.map.images]
    order = ["z.png", names[5], names[3], names[1]]
    assert [fault.photo for fault in photo_faults(known)] == order
