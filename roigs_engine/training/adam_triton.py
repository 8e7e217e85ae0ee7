"""A step of `optimizer.VisibleAdam` as one Triton kernel: reads and writes each value once."""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

ELEMENTS = 1024  # per Triton program


# Triton takes tuples as one argument.
@triton.jit
def _step(
    tensors,  # parameter, gradient, exp_avg, exp_avg_sq
    visible,
    learning_rates,
    row_rates,  # or null
    skipped,
    count,
    factors,  # scale, beta1, beta2, 1 - beta1, 1 - beta2 (which float32 cannot make), eps
    SHAPE: tl.constexpr,  # noqa: N803 - width, width rounded up to a power of two, rows
) -> Any:
    parameter, gradient, exp_avg, exp_avg_sq = tensors
    scale, beta1, beta2, share1, share2, eps = factors
    WIDTH: tl.constexpr = SHAPE[0]  # noqa: N806
    rows = tl.program_id(0) * SHAPE[2] + tl.arange(0, SHAPE[2])
    columns = tl.arange(0, SHAPE[1])
    seen = tl.load(visible + rows, mask=rows < count, other=0) != 0
    inside = seen[:, None] & (columns[None, :] < WIDTH)
    at = rows[:, None].to(tl.int64) * WIDTH + columns[None, :]
    g = tl.load(gradient + at, mask=inside, other=0.0)
    infinite = ~(tl.abs(g) < float("inf"))  # NaN too
    bad = tl.max(infinite.to(tl.int32), axis=1) > 0
    wrong = tl.sum(bad.to(tl.int32), axis=0)
    if wrong > 0:
        tl.atomic_add(skipped, wrong)
    on = inside & (bad == 0)[:, None]
    m = tl.load(exp_avg + at, mask=on, other=0.0)
    v = tl.load(exp_avg_sq + at, mask=on, other=0.0)
    x = tl.load(parameter + at, mask=on, other=0.0)
    rate = tl.load(learning_rates + columns, mask=columns < WIDTH, other=0.0)[None, :]
    if row_rates is not None:
        rate = rate * tl.load(row_rates + rows, mask=rows < count, other=0.0)[:, None]
    m = beta1 * m + share1 * g
    v = beta2 * v + share2 * g * g
    x -= scale * rate * m / (tl.sqrt(v) + eps)
    tl.store(exp_avg + at, m, mask=on)
    tl.store(exp_avg_sq + at, v, mask=on)
    tl.store(parameter + at, x, mask=on)


def step(
    parameter: Tensor,  # (N, ...) float32
    moments: tuple[Tensor, Tensor],  # exp_avg, exp_avg_sq, as the parameter
    visible: Tensor,  # (N,) bool
    learning_rates: Tensor,  # (W,) one for each column of a row
    *,
    betas: tuple[float, float],
    eps: float,
    step_count: int,
    row_rates: Tensor | None = None,  # (N,) factors of the rates
) -> Tensor:
    """Updates parameter and moments in place by `parameter.grad`.

    Returns (1,) int32: the number of visible rows that were skipped for a NaN or Inf gradient.
    """
    skipped = torch.zeros(1, dtype=torch.int32, device=parameter.device)
    count, width = len(parameter), learning_rates.numel()
    assert parameter.grad is not None
    if count == 0:
        return skipped
    # lr m/c1 / (sqrt(v/c2) + eps) = (lr sqrt(c2)/c1) m / (sqrt(v) + eps sqrt(c2))
    correction = 1 - betas[0] ** step_count, (1 - betas[1] ** step_count) ** 0.5
    scale = correction[1] / correction[0]
    columns = triton.next_power_of_2(width)
    rows = max(1, ELEMENTS // columns)
    _step[(triton.cdiv(count, rows),)](
        (parameter, parameter.grad.contiguous(), *moments),
        visible.contiguous(),
        learning_rates,
        row_rates,
        skipped,
        count,
        (scale, *betas, 1 - betas[0], 1 - betas[1], eps * correction[1]),
        SHAPE=(width, columns, rows),
    )
    return skipped
