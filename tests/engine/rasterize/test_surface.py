"""Depth and normals of surfaces: what they are, in each backend, and their gradients."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import pytest
import torch
from torch import Tensor

from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.inputs import BackwardStep, Surface
from roigs_engine.rasterize.limits import TRAINING_LIMITS
from roigs_engine.rasterize.tiles import active_tiles
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.rasterize_cases import (
    BACKGROUND,
    CASES,
    NAMES,
    SIZE,
    cameras,
    dots_to_needles,
    gaussians,
    largest_difference,
    relative_error,
    render_both,
)
from tests.engine.training.adam_from_gradients import AdamFromGradients

Adam = TypeVar("Adam", bound=VisibleAdam)

FOCAL, SIDE = 40.0, 32
OPTIONS: dict[str, Any] = {"with_surface": True, "background": BACKGROUND}


def surface_of(*given: Any, **options: Any) -> Surface:
    surface = rasterize(*given, with_surface=True, **options).surface
    assert surface is not None
    return surface


def disc(normal: Tensor, thickness: float = 1e-5, opacity: float = 0.99) -> list[Tensor]:
    """A flat Gaussian around (0.1, -0.05, 3), across this unit vector, float64."""
    between = torch.nn.functional.normalize(normal + torch.tensor([0.0, 0.0, 1.0]), dim=0)
    turn = torch.cat([torch.zeros(1), between]).double()  # half a turn, z to the normal
    return [
        torch.tensor([[0.1, -0.05, 3.0]]).double(),
        turn[None],
        torch.tensor([[0.4, 0.3, thickness]]).double(),
        torch.tensor([opacity]).double(),
        torch.zeros(1, 1, 3).double(),
    ]


def lens() -> tuple[Tensor, Tensor, int, int]:
    matrix = torch.tensor([[FOCAL, 0.0, SIDE / 2], [0.0, FOCAL, SIDE / 2], [0.0, 0.0, 1.0]])
    return torch.eye(4).double()[None], matrix.double()[None], SIDE, SIDE


@pytest.mark.parametrize("normal", [[0.01, 0.0, -1.0], [0.5, 0.0, -0.866], [0.3, -0.4, -0.866]])
def test_a_disc_is_its_plane(normal: list[float]) -> None:
    across = torch.nn.functional.normalize(torch.tensor(normal).double(), dim=0)
    parameters = disc(across.float())
    surface = surface_of(*parameters, *lens())
    alpha = rasterize(*parameters, *lens()).alpha[0]
    shown = alpha > 0.5
    found = surface.normal[0][shown] / alpha[shown][:, None]
    assert largest_difference(found, across.expand_as(found)) < 2e-3
    y, x = (shown.nonzero().double() + 0.5 - SIDE / 2).unbind(1)
    rays = torch.stack([x / FOCAL, y / FOCAL, torch.ones_like(x)], dim=1)
    exact = (parameters[0][0] @ across) / (rays @ across)  # rays are not parallel: nearly
    assert float((surface.median[0][shown] - exact).abs().max()) < 0.02
    assert float((surface.depth[0][shown] - exact).abs().max()) < 0.02


def test_the_median_is_that_of_more_than_half_of_the_light() -> None:
    faint = surface_of(*disc(torch.tensor([0.3, 0.0, -0.95]), opacity=0.4), *lens())
    assert not faint.median.any() and faint.depth.any()


def test_gradients_are_those_of_differences() -> None:
    parameters = [p.double().requires_grad_() for p in gaussians(12, coefficients=1, size=0.3)]
    scene = (*(matrix.double() for matrix in cameras(12, 9)), 12, 9)

    def shown(*given: Tensor) -> tuple[Tensor, ...]:
        output = rasterize(*given, *scene, with_surface=True)
        assert output.surface is not None
        return output.alpha, *output.surface

    assert torch.autograd.gradcheck(
        shown, parameters, eps=1e-7, rtol=1e-3, fast_mode=True, check_undefined_grad=False
    )


@pytest.mark.parametrize("name", CASES)
def test_kernels_match(isa: str, name: str) -> None:
    options = CASES[name] | {"with_surface": True}
    ours, truth, errors = render_both(
        gaussians(150, coefficients=4), *cameras(*SIZE), *SIZE, **options
    )
    assert ours.surface is not None and truth.surface is not None
    for part, expected in zip(ours.surface, truth.surface, strict=True):
        assert largest_difference(part, expected) < 1e-3
    assert relative_error(ours.grad2d, truth.grad2d) < 1e-4
    assert max(errors.values()) < 1e-4, errors


def test_planes_of_dots_and_needles_are_finite() -> None:
    parameters = [p.requires_grad_() for p in dots_to_needles(300)]
    surface = surface_of(*parameters, *cameras(*SIZE), *SIZE)
    sum(part.sum() for part in surface).backward()
    for each in (*surface, *(p.grad for p in parameters[:4])):
        assert each is not None and bool(each.isfinite().all())


@pytest.mark.parametrize("options", [{}, {"limits": TRAINING_LIMITS}, {"with_depth": "median"}])
def test_beside_it_nothing_changes(isa: str, options: dict[str, Any]) -> None:
    found = []
    for with_surface in (False, True):
        parameters = [p.requires_grad_() for p in gaussians(300, coefficients=4)]
        scene = (*cameras(*SIZE), *SIZE)
        output = rasterize(*parameters, *scene, with_surface=with_surface, **options)
        output.image.square().sum().backward()
        tensors = [output.image, output.alpha, output.visible, *(p.grad for p in parameters)]
        found.append([*tensors, output.depth] if options.get("with_depth") else tensors)
    for plain, beside in zip(*found, strict=True):
        assert torch.equal(plain, beside)


def test_a_window_holds_its_part() -> None:
    scene = (*gaussians(200, coefficients=1), *cameras(*SIZE), *SIZE)
    tiles = active_tiles(*SIZE, (16, 16, 48, 43))
    whole = surface_of(*scene, mask=tiles)
    part = surface_of(*scene, mask=replace(tiles, window=(16, 16, 48, 43)))
    for one, other in zip(part, whole, strict=True):
        assert torch.equal(one, other[:, 16:43, 16:48])


def stepped(adam: VisibleAdam, step: BackwardStep | None) -> RenderOutput:
    view = [matrix[:1] for matrix in cameras(*SIZE)]
    given = adam.parameters.values()
    output = rasterize(*given, *view, *SIZE, raw=True, with_surface=True, backward_step=step)
    assert output.surface is not None
    (output.image.sum() + output.surface.median.sum() + output.surface.normal.sum()).backward()
    return output


def test_a_step_inside_the_backward_pass_has_the_bits_of_one_after_it(isa: str) -> None:
    def adam(kind: type[Adam]) -> Adam:
        parameters = zip(NAMES, gaussians(150, raw=True), strict=True)
        return kind({name: (parameter, 0.01) for name, parameter in parameters})

    inside, after = adam(VisibleAdam), adam(AdamFromGradients)
    stepped(inside, inside.backward_step)
    after.step(stepped(after, None).visible[0])
    for name, parameter in inside.parameters.items():
        assert torch.equal(parameter, after.parameters[name]), name
