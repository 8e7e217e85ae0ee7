"""A step of `optimizer.VisibleAdam` as one Triton kernel: what it reads and writes, once each."""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

ELEMENTS = 1024  # that one program takes on


@triton.jit
def _step(
    parameter,
    gradient,
    exp_avg,
    exp_avg_sq,
    visible,
    rates,
    skipped,
    count,
    scale,
    beta1,
    beta2,
    share1,  # 1 - beta1, which float32 cannot make of beta1
    share2,
    eps,
    WIDTH: tl.constexpr,  # noqa: N803
    COLUMNS: tl.constexpr,  # noqa: N803 - WIDTH rounded up to a power of two
    ROWS: tl.constexpr,  # noqa: N803
) -> Any:
    rows = tl.program_id(0) * ROWS + tl.arange(0, ROWS)
    columns = tl.arange(0, COLUMNS)
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
    rate = tl.load(rates + columns, mask=columns < WIDTH, other=0.0)
    m = beta1 * m + share1 * g
    v = beta2 * v + share2 * g * g
    x -= scale * rate[None, :] * m / (tl.sqrt(v) + eps)
    tl.store(exp_avg + at, m, mask=on)
    tl.store(exp_avg_sq + at, v, mask=on)
    tl.store(parameter + at, x, mask=on)


def step(
    parameter: Tensor,  # (N, ...) float32
    gradient: Tensor,  # as the parameter
    exp_avg: Tensor,
    exp_avg_sq: Tensor,
    visible: Tensor,  # (N,) bool
    rates: Tensor,  # (W,) a learning rate for each column of a row
    betas: tuple[float, float],
    eps: float,
    step_count: int,
) -> Tensor:
    """Updates parameter and moments in place; (1,) int32: rows whose gradient was not finite."""
    skipped = torch.zeros(1, dtype=torch.int32, device=parameter.device)
    count, width = len(parameter), rates.numel()
    if count == 0:
        return skipped
    # lr m/c1 / (sqrt(v/c2) + eps) = (lr sqrt(c2)/c1) m / (sqrt(v) + eps sqrt(c2))
    correction = 1 - betas[0] ** step_count, (1 - betas[1] ** step_count) ** 0.5
    columns = triton.next_power_of_2(width)
    rows = max(1, ELEMENTS // columns)
    _step[(triton.cdiv(count, rows),)](
        parameter,
        gradient.contiguous(),
        exp_avg,
        exp_avg_sq,
        visible.contiguous(),
        rates,
        skipped,
        count,
        correction[1] / correction[0],
        *betas,
        1 - betas[0],
        1 - betas[1],
        eps * correction[1],
        WIDTH=width,
        COLUMNS=columns,
        ROWS=rows,
    )
    return skipped
