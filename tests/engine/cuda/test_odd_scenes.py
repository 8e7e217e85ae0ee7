"""Scenes at the edge of what there is, on the CUDA kernels in the shim: as on the CPU.

With buffers for pairs they have the same bits as without.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from roigs_engine.cuda.pair_buffers import PairBuffer
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import cuda
from tests.engine.cuda.shim import ShimProgram
from tests.engine.odd_scenes import SCENES, SIZES, Model, as_on_the_cpu, step
from tests.engine.rasterize_cases import gaussians


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
