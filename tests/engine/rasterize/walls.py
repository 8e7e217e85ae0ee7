"""Walls behind one another: which of them get light, and a gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.limits import TRAINING_LIMITS, Limits
from tests.engine.rasterize_cases import cameras

SIZE = (80, 48)


def layers(opacities: list[float]) -> tuple[list[Tensor], Tensor, Tensor]:
    """White walls that fill the picture, one behind the other; a camera."""
    count = len(opacities)
    means = torch.tensor([[0.0, 0.0, 4.0 + 3.0 * i / (count - 1)] for i in range(count)])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1)
    scales = torch.tensor([[50.0, 50.0, 0.01]]).repeat(count, 1)
    parameters = [means, quats, scales, torch.tensor(opacities), torch.ones(count, 1, 3)]
    return parameters, torch.eye(4)[None], cameras(*SIZE)[1][:1]


def with_gradient(opacities: list[float], limits: Limits, backend: str) -> list[int]:
    """1 for each wall that gets a gradient, else 0."""
    parameters, view, intrinsics = layers(opacities)
    leaves = [p.requires_grad_() for p in parameters]
    options: dict[str, Any] = {"limits": limits, "backend": backend}
    rasterize(*leaves, view, intrinsics, *SIZE, **options).image.sum().backward()
    gradient = leaves[4].grad
    assert gradient is not None
    return (gradient.abs().sum(dim=(1, 2)) > 0).int().tolist()


def behind_a_haze(backend: str) -> tuple[float, float]:
    """The opacity gradient of a wall behind forty walls that get none, and the reference's."""
    found = []
    for name in (backend, "reference"):
        parameters, view, intrinsics = layers([0.9] + 40 * [0.0095] + [0.95])
        parameters[4][0], parameters[4][-1] = 0.5, 0.2
        opacities = parameters[3].requires_grad_()
        options: dict[str, Any] = {"limits": TRAINING_LIMITS, "backend": name}
        rasterize(*parameters, view, intrinsics, *SIZE, **options).image.mean().backward()
        assert opacities.grad is not None
        found.append(float(opacities.grad[-1]))
        hidden = opacities.grad[1:-1].any()
        assert bool(hidden) == (name == "reference")
    return found[0], found[1]
