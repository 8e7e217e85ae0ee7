"""Models that are partly there."""

from __future__ import annotations

import torch

from roigs_engine.model.faded import MOST, faded

LOGITS = torch.tensor([-80.0, -10.0, 0.0, 3.0, 15.0, 80.0])


def test_as_much_light_comes_through_two_parts_as_through_the_whole() -> None:
    for density in (0.999999, 0.5, 1e-3):
        one, other = faded(LOGITS, density), faded(LOGITS, 1 - density)
        assert torch.isfinite(one).all() and one.dtype == LOGITS.dtype
        assert (one.sigmoid() <= LOGITS.sigmoid() + 1e-6).all()
        through = (1 - one.double().sigmoid()) * (1 - other.double().sigmoid())
        whole = 1 - LOGITS.double().sigmoid().clamp(max=MOST)
        torch.testing.assert_close(through, whole, atol=1e-6, rtol=1e-3)


def test_what_is_all_there_keeps_every_bit() -> None:
    assert torch.equal(faded(LOGITS, 1.0), LOGITS)
