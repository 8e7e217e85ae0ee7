"""Scenes at the edge of what there is, and a training step on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from roigs_engine.cuda.pair_buffers import PairBuffer
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import rasterize
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.rasterize_cases import cameras, gaussians, largest_difference, relative_error

Model = list[Tensor]


def one() -> Model:
    return [p[:1].clone() for p in gaussians(3, raw=True)]


def behind() -> Model:
    made = gaussians(40, raw=True)
    made[0][:, 2] -= 40
    return made


def in_the_camera_plane() -> Model:
    made = gaussians(40, raw=True)
    made[0][::2, 2] = torch.linspace(-0.02, 0.02, 20)
    return made


def over_all_tiles() -> Model:
    made = gaussians(30, raw=True)
    made[2][:] = 6.0  # 400 units
    made[3][:] = -1.0
    return made


def degenerate_rotations() -> Model:
    made = gaussians(40, raw=True)
    made[1][::4] = 0.0
    made[1][1::4] = 1e-30
    made[1][2::4] = 1e18
    return made


def extreme_numbers() -> Model:
    made = gaussians(48, raw=True)
    made[2][0::6] = 80.0  # exp overflows
    made[2][1::6] = -90.0
    made[3][2::6] = 100.0
    made[3][3::6] = -100.0
    made[0][4::6] = 1e30
    made[4][5::6] = 1e30
    return made


SCENES: list[Callable[[], Model]] = [
    *(one, behind, in_the_camera_plane, over_all_tiles, degenerate_rotations, extreme_numbers)
]
SIZES = [(1, 1), (17, 16), (16, 17), (48, 33)]


def step(
    model: Model, size: tuple[int, int], backend: str, buffer: PairBuffer | None = None
) -> tuple[dict[str, Tensor], VisibleAdam]:
    """A training step; what it draws, and the optimizer after it."""
    parameters = [p.clone() for p in model]
    pairs = zip(NAMES, parameters, strict=True)
    optimizer = VisibleAdam({name: (p, 1e-3) for name, p in pairs})
    views = (camera[:1] for camera in cameras(*size))
    drawn = rasterize(
        *parameters,
        *views,
        *size,
        raw=True,
        with_max_weight=True,
        backend=backend,
        backward_step=replace(optimizer.backward_step, pair_buffer=buffer),
    )
    weights = torch.randn(drawn.image.shape, generator=torch.Generator().manual_seed(1))
    (drawn.image * weights).sum().backward()
    names = ("image", "alpha", "visible", "grad2d", "max_weight")
    return {name: getattr(drawn, name).detach() for name in names}, optimizer


def as_on_the_cpu(model: Model, size: tuple[int, int], backend: str) -> None:
    ours, mine = step(model, size, backend)
    truth, theirs = step(model, size, "cpu")
    assert torch.equal(ours["visible"], truth["visible"])
    for name in ("image", "alpha", "max_weight"):
        scale = max(1.0, float(truth[name].abs().max()))
        assert largest_difference(ours[name] / scale, truth[name] / scale) < 1e-4, name
    assert int(mine.skipped_rows) == int(theirs.skipped_rows)
    for name in NAMES:
        moments, right = mine.exp_avg[name], theirs.exp_avg[name]
        assert torch.equal(moments.isfinite(), right.isfinite())
        assert relative_error(moments, right) < 1e-3 or float(right.norm()) < 1e-10, name
