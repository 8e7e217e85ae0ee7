"""Rows of a tensor in another order, copied by all threads of the kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from ..kernels import bindings


def chosen_rows(matrix: Tensor, rows: Tensor) -> Tensor:
    """Copies of rows, without gradient.

    Args:
        matrix: (N, ...).
        rows: (M,) long, the row of `matrix` that each new row copies; -1: zeros.
    """
    matrix = matrix.detach()
    on_kernels = matrix.device.type == "cpu" and matrix.dtype == torch.float32
    if on_kernels and matrix.is_contiguous():
        found = torch.empty(len(rows), *matrix.shape[1:], dtype=torch.float32)
        chosen, width = rows.contiguous(), matrix.shape[1:].numel()
        source, target = bindings.pointer(matrix), bindings.pointer(found)
        bindings.kernels().roigs_copy_rows(
            source, len(matrix), width, bindings.pointer(chosen), len(chosen), target
        )
        return found
    if len(matrix) == 0:
        return matrix.new_zeros(len(rows), *matrix.shape[1:])
    fresh = (rows < 0).nonzero()[:, 0]  # row numbers: a mask of whole rows takes much longer
    return matrix.index_select(0, rows.clamp(min=0)).index_fill_(0, fresh, 0)
