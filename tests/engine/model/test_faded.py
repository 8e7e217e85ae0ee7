"""Models that are partly there."""

from __future__ import annotations

import torch

from roigs_engine.model.operations import LEAST, faded

LOGITS = torch.tensor([-80.0, -10.0, 0.0, 2.0, 3.0, 15.0, 80.0])


def through(logits: torch.Tensor) -> torch.Tensor:
    return (-logits.double()).sigmoid()


def test_as_much_light_comes_through_two_parts_as_through_the_whole() -> None:
    thin = LOGITS[through(LOGITS) >= LEAST]
    for density in (0.999999, 0.5, 1e-3):
        both = through(faded(thin, density)) * through(faded(thin, 1 - density))
        torch.testing.assert_close(both, through(thin), atol=1e-6, rtol=1e-3)


def test_what_is_opaque_fades_evenly_and_lets_little_through() -> None:
    steps = torch.linspace(0.01, 1, 100)
    now = torch.stack([through(faded(LOGITS, float(density))) for density in steps])
    assert torch.isfinite(now).all() and now.dtype == torch.float64
    assert (now.diff(dim=0) <= 1e-7).all() and (now.diff(dim=0) > -0.035).all()
    torch.testing.assert_close(now[-1], through(LOGITS), atol=1e-7, rtol=1e-6)
    assert (now * now.flip(0)).min(dim=0).values[-1] < LEAST / 3


def test_what_is_all_there_keeps_every_bit() -> None:
    assert torch.equal(faded(LOGITS, 1.0), LOGITS)
    assert faded(LOGITS, 0.5).dtype == LOGITS.dtype
