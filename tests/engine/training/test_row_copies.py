"""Rows in another order: the compiled kernel and plain torch give the same."""

from __future__ import annotations

import pytest
import torch

from roigs_engine.kernels import library
from roigs_engine.training.edits import chosen_rows


@pytest.mark.parametrize("shape", [(), (3,), (16, 3)])
@pytest.mark.parametrize("threads", [1, 3])
def test_rows_are_copied_and_new_ones_are_zero(
    isa: str, shape: tuple[int, ...], threads: int
) -> None:
    library.set_threads(threads)
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(3000, *shape, generator=generator)
    rows = torch.randint(-1, 3000, (5000,), generator=generator)
    rows[::7] = -1
    found = chosen_rows(matrix.requires_grad_(), rows)
    assert not found.requires_grad
    assert torch.equal(found, chosen_rows(matrix.double(), rows).float())
    assert torch.equal(found[rows >= 0], matrix[rows[rows >= 0]])
    assert not found[rows < 0].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_nothing_to_copy_from(dtype: torch.dtype) -> None:
    empty = torch.zeros(0, 4, dtype=dtype)
    assert torch.equal(chosen_rows(empty, torch.full((3,), -1)), torch.zeros(3, 4, dtype=dtype))
    assert chosen_rows(torch.ones(5, 4, dtype=dtype), torch.zeros(0).long()).shape == (0, 4)


def test_a_view_with_gaps() -> None:
    matrix = torch.arange(24.0).reshape(6, 4)[:, :2]
    assert chosen_rows(matrix, torch.tensor([5, -1, 0])).tolist() == [[20, 21], [0, 0], [0, 1]]
