"""Scenes at the edge of what there is, on the CUDA kernels in the shim: as on the CPU.

With buffers for pairs they have the same bits as without.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from roigs_engine.cuda.pair_buffers import PairBuffer
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import cuda, rasterize
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.cuda.shim import ShimProgram
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


class FixedBuffer:
    """PairBuffer for so many pairs, and who was told how many there are."""

    def __init__(self, pairs: int | None) -> None:
        self.void = torch.zeros((), dtype=torch.bool)
        self.told: list[int] = []
        self.buffer = PairBuffer(capacity=pairs, void=self.void, report=self._report)

    def _report(self, total: Tensor | int) -> None:
        self.told.append(int(total))
        if self.buffer.capacity is not None:
            torch.logical_or(
                self.void, torch.as_tensor(total > self.buffer.capacity), out=self.void
            )


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


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scene", SCENES)
def test_they_are_drawn_and_trained_as_on_the_cpu(
    shim: ShimProgram, scene: Callable[[], Model], size: tuple[int, int]
) -> None:
    as_on_the_cpu(scene(), size, "cuda")


@pytest.mark.parametrize("scene", SCENES)
def test_larger_buffers_than_pairs_changes_no_bit(
    shim: ShimProgram, scene: Callable[[], Model]
) -> None:
    model, size = scene(), (48, 33)
    new = FixedBuffer(None)
    exact, first = step(model, size, "cuda", new.buffer)
    (pairs,) = new.told
    for more in (0, 1, 1000):
        fixed = FixedBuffer(pairs + more)
        ours, second = step(model, size, "cuda", fixed.buffer)
        assert fixed.told == [pairs] and not fixed.void
        for name, tensor in exact.items():
            assert torch.equal(ours[name], tensor), (name, more)
        for name in NAMES:
            assert torch.equal(second.parameters[name], first.parameters[name])
            assert torch.equal(second.exp_avg_sq[name], first.exp_avg_sq[name])


@pytest.mark.parametrize("few_tiles", [False, True])
def test_without_a_buffer_nothing_is_drawn_and_nothing_changes(
    shim: ShimProgram, monkeypatch: pytest.MonkeyPatch, *, few_tiles: bool
) -> None:
    """Nor after it, until somebody says so: not even a view whose pairs are counted first."""
    if not few_tiles:
        monkeypatch.setattr(cuda, "SHORT_TILES", 3)
    model = gaussians(60, raw=True)
    fixed = FixedBuffer(30)
    for pairs in (30, 10_000, None):
        fixed.buffer = PairBuffer(capacity=pairs, void=fixed.void, report=fixed._report)
        drawn, optimizer = step(model, (48, 33), "cuda", fixed.buffer)
        assert fixed.told[-1] > 60 and fixed.void
        assert not any(tensor.any() for tensor in drawn.values())
        for name, before in zip(NAMES, model, strict=True):
            assert torch.equal(optimizer.parameters[name], before)
            assert not optimizer.exp_avg[name].any()
