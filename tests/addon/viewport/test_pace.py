"""Resolution of a viewport while it changes."""

from __future__ import annotations

from roigs_addon.viewport.pace import COARSEST, QUICK, full_seconds, pixel


def test_a_quick_picture_is_always_full() -> None:
    for held in (None, 1, 2):
        for rested in (False, True):
            assert pixel(None, held, rested) == 1  # nothing is known yet
            assert pixel(QUICK, held, rested) == 1


def test_a_slow_picture_is_coarse_until_the_view_rests() -> None:
    assert pixel(1.5 * QUICK, None, False) == pixel(1.5 * QUICK, None, True) == 2
    assert pixel(2.0, None, True) == COARSEST
    assert pixel(2.0, 2, False) == 2  # something else in the window was redrawn
    assert pixel(2.0, 1, False) == 1
    assert pixel(2.0, 2, True) == 1


def test_a_quick_coarse_picture_shows_that_the_full_one_is_quick() -> None:
    assert full_seconds(0.7, 1, None) == full_seconds(0.7, 1, 3.0) == 0.7
    assert full_seconds(0.0625, 2, 0.7) == 0.25
    assert full_seconds(0.3, 3, 0.7) == 0.7
    assert full_seconds(0.3, 3, None) is None
