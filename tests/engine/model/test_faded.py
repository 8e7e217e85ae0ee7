"""Gaussians that let more through."""

from __future__ import annotations

import torch

from roigs_engine.model.faded import faded

LOGITS = torch.tensor([-80.0, -10.0, 0.0, 3.0, 15.0, 80.0])


def test_opacities_are_multiplied_and_stay_finite() -> None:
    for factor in (0.999999, 0.5, 1e-3):
        made = faded(LOGITS, factor)
        assert torch.isfinite(made).all() and made.dtype == LOGITS.dtype
        torch.testing.assert_close(made.sigmoid(), LOGITS.sigmoid() * factor, atol=1e-6, rtol=1e-4)


def test_a_factor_of_one_keeps_every_bit() -> None:
    assert torch.equal(faded(LOGITS, 1.0), LOGITS)
