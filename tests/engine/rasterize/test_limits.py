"""Very many Gaussians, tiles and pairs of them: the right result, or an error that says so."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError, KernelError
from roigs_engine.rasterize import RenderOutput, rasterize
from tests import warm_engine
from tests.engine.commands.command_line import ROOT
from tests.engine.rasterize_cases import cameras, gaussians

EIGHT_K = (7680, 4320)


def render_8k(parameters: list[Tensor], **options: object) -> RenderOutput:
    intrinsics = torch.tensor([[[7000.0, 0.0, 3840.0], [0.0, 7000.0, 2160.0], [0.0, 0.0, 1.0]]])
    return rasterize(*parameters, torch.eye(4)[None], intrinsics, *EIGHT_K, **options)


def corner_render(parameters: list[Tensor]) -> RenderOutput:
    """The last 64 by 32 pixels of `render_8k`, as an image of their own."""
    x, y = EIGHT_K[0] - 64, EIGHT_K[1] - 32
    intrinsics = torch.tensor([[[7000.0, 0, 3840.0 - x], [0, 7000.0, 2160.0 - y], [0, 0, 1.0]]])
    scene = [p.double() for p in parameters], torch.eye(4)[None].double(), intrinsics.double()
    return rasterize(*scene[0], *scene[1:], 64, 32, backend="reference")


def in_the_corner(count: int) -> list[Tensor]:
    """Gaussians of some pixels' size about the corner of `render_8k`'s image."""
    parameters = gaussians(count, coefficients=1, size=0.003)
    corner = 4.0 * torch.tensor([3810.0 / 7000, 2145.0 / 7000, 1.0])
    parameters[0] = corner + 0.01 * torch.randn(
        count, 3, generator=torch.Generator().manual_seed(3)
    )
    return parameters


def test_8k() -> None:
    corner, everywhere = in_the_corner(60), gaussians(1000, coefficients=1, size=0.01)
    apart = everywhere[0][:, :2] < torch.tensor([1.9, 1.0])  # so that nothing covers the corner
    parameters = [torch.cat([c, e[apart.all(1)]]) for c, e in zip(corner, everywhere, strict=True)]
    inputs = [p.requires_grad_() for p in parameters]
    output = render_8k(inputs)
    expected = corner_render(corner)
    assert float(expected.alpha.mean()) > 0.2
    difference = (output.image[:, -32:, -64:] - expected.image).detach().abs()
    assert float(difference.max()) < 1e-2 and float(difference.mean()) < 1e-4
    output.image.sum().backward()
    for p in inputs:
        assert p.grad is not None and torch.isfinite(p.grad).all()
    assert bool((inputs[3].grad[:60] != 0).any())


@pytest.mark.skipif(sys.platform != "linux", reason="reads its memory in Linux's units")
@pytest.mark.skipif(sys.platform != "linux", reason="measures the kernel's count")
def test_too_many_intersections_are_refused_at_once() -> None:
    """34,000 Gaussians on all of an 8K image's 129,600 tiles; in a process, to see its memory."""
    command = warm_engine.module("tests.engine.rasterize.too_many_pairs")
    result = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    error, peak = result.stdout.splitlines()
    assert error.startswith("This view has more than 2^31 ")
    assert float(peak) < 2048, "MiB"


def test_too_many_gaussians_are_refused() -> None:
    n = 2**30 + 1
    shapes = [(3,), (4,), (3,), (), (1, 3)]
    parameters = [torch.ones(1, *shape).expand(n, *shape) for shape in shapes]  # without memory
    with pytest.raises(KernelError, match="Gaussians are too many"):
        rasterize(*parameters, *cameras(8, 8), 8, 8)


def test_too_large_images_are_refused() -> None:
    with pytest.raises(EngineError, match="too large"):
        rasterize(*gaussians(9), *cameras(8, 8), 2**16 + 1, 8)


@pytest.mark.slow
def test_more_pairs_than_are_listed_at_first() -> None:
    """Beyond 2^27 pairs, tiles are counted first and listed then; the image is the same."""
    parameters = gaussians(1500, coefficients=1, size=5.0)
    parameters[0][:, :2] *= 0.01
    parameters[3] = torch.full((1500,), 0.02)
    whole = render_8k(parameters)
    part = render_8k(parameters, mask=(4000, 2000, 4064, 2032))
    assert int(whole.visible.sum()) > 1100
    rows, columns = slice(2000, 2032), slice(4000, 4064)
    assert torch.equal(whole.image[:, rows, columns], part.image[:, rows, columns])


@pytest.mark.slow
def test_more_gaussians_than_float32_counts() -> None:
    """Only the last rows beyond 2^24 are in view."""
    n, seen = 2**24 + 5000, 200
    few = gaussians(seen, coefficients=1)
    parameters = [torch.zeros(n, *p.shape[1:]) for p in few]
    for p, rows in zip(parameters, few, strict=True):
        p[-seen:] = rows
    parameters[0][:-seen, 2] = -1.0
    size = (61, 43)
    colours = parameters[4].requires_grad_()
    output = rasterize(*parameters, *cameras(*size), *size, with_max_weight=True)
    expected = rasterize(*few, *cameras(*size), *size, with_max_weight=True)
    assert torch.equal(output.image, expected.image)
    assert torch.equal(output.visible[:, -seen:], expected.visible)
    assert not output.visible[:, :-seen].any()
    assert output.max_weight is not None and expected.max_weight is not None
    assert torch.equal(output.max_weight[-seen:], expected.max_weight)
    output.image.sum().backward()
    assert colours.grad is not None
    assert bool(colours.grad[-seen:].any()) and not bool(colours.grad[:-seen].any())
