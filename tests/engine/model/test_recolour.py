"""Gaussians made brighter, darker or tinted."""

from __future__ import annotations

import pytest
import torch

from roigs_engine.model.operations import recoloured
from roigs_engine.rasterize.reference import sh_basis

GAINS = (2.5, 0.25, 0.0)


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_colours_are_multiplied_from_anywhere(coefficients: int) -> None:
    made = torch.Generator().manual_seed(1)
    sh = torch.randn((50, coefficients, 3), generator=made)
    seen = torch.nn.functional.normalize(torch.randn((50, 3), generator=made), dim=1)
    basis = sh_basis(seen)[:, :coefficients]

    def colours(values: torch.Tensor) -> torch.Tensor:
        return (0.5 + torch.einsum("vk,vkc->vc", basis, values)).clamp(min=0)

    assert (colours(sh) == 0).any(), "some colours are cut off"
    wanted = colours(sh) * torch.tensor(GAINS)
    torch.testing.assert_close(colours(recoloured(sh, GAINS)), wanted, atol=1e-5, rtol=1e-5)


def test_no_gain_keeps_every_bit() -> None:
    sh = torch.randn((50, 16, 3), generator=torch.Generator().manual_seed(2))
    before = sh.clone()
    assert torch.equal(recoloured(sh, (1.0, 1.0, 1.0)), before)
    recoloured(sh, GAINS)
    assert torch.equal(sh, before)
