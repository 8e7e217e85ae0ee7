"""Edits of a model that keep the optimizer's state: each new row names its source row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..kernels import bindings
from ..model.gaussians import Gaussians
from ..model.rotations import rotation_matrices

SPLIT_SHRINK = 1.6  # 3DGS: children of a split have their scales divided by this


@dataclass(frozen=True, kw_only=True, eq=False)
class Edit:
    """Edited Gaussians.

    Attributes:
        gaussians: the edited model, M rows.
        rows: (M,) the old row of each new row, whose optimizer state it keeps; -1 for a new
            Gaussian. None if the rows did not change.
        opacity_cap: upper limit for opacities; their moments become zero. None for no limit.
    """

    gaussians: Gaussians
    rows: Tensor | None
    opacity_cap: float | None = None

    def keep(self, rows: Tensor) -> Edit:
        """Return the edit with some of its rows: a bool mask (M,) or row numbers in a new order."""
        assert self.rows is not None
        return replace(self, gaussians=self.gaussians.rows(rows), rows=self.rows[rows])


def unchanged(gaussians: Gaussians) -> Edit:
    """Return an edit that keeps every row; `Edit.keep` can then drop some."""
    rows = torch.arange(len(gaussians), device=gaussians.means.device)
    return Edit(gaussians=gaussians, rows=rows)


def clone_and_split(
    gaussians: Gaussians,
    mask: Tensor,
    reference: Tensor,
    fraction: float,
    rng: torch.Generator,
    choose: Callable[[Gaussians], Tensor] | None = None,
) -> Edit:
    """Clone the small and split the large Gaussians of a mask.

    A clone is added to its original; two samples of a split Gaussian replace it.

    Args:
        gaussians: the model, N rows.
        mask: (N,) bool, the Gaussians to densify.
        reference: (N,) size reference, world units.
        fraction: Gaussians larger than `fraction` x `reference` are split.
        rng: draws the positions of split Gaussians.
        choose: gets the edited Gaussians with only SH of degree 0, and returns the numbers of the
            rows to keep, in their new order. None keeps all.
    """
    large = gaussians.log_scales.detach().exp().amax(dim=1) > fraction * reference
    kept = torch.nonzero(~(mask & large)).flatten()
    clones = torch.nonzero(mask & ~large).flatten()
    parents = torch.nonzero(mask & large).flatten().repeat(2)
    copied = torch.cat([kept, clones])
    sources = torch.cat([copied, parents])
    rows = torch.cat([kept, kept.new_full((len(clones) + len(parents),), -1)])
    # SH are most of a Gaussian's data and no edit changes them: they are copied once, at the end.
    plain = replace(gaussians, sh=gaussians.sh[:, :1])
    edited = Gaussians.concatenate([plain.rows(copied), _children(plain.rows(parents), rng)])
    if choose is not None:
        chosen = choose(edited)
        edited, rows, sources = edited.rows(chosen), rows[chosen], sources[chosen]
    return Edit(gaussians=replace(edited, sh=chosen_rows(gaussians.sh, sources)), rows=rows)


def _children(parents: Gaussians, rng: torch.Generator) -> Gaussians:
    """Return each parent, moved to a random sample of itself and shrunk."""
    scales = parents.log_scales.exp()
    # drawn on the CPU, for the same numbers on every device
    offsets = torch.randn(scales.shape, generator=rng).to(scales.device) * scales
    rotations = rotation_matrices(torch.nn.functional.normalize(parents.quats, dim=1))
    values = parents.tensors()
    values["means"] = parents.means + (rotations @ offsets[..., None])[..., 0]
    values["log_scales"] = (scales / SPLIT_SHRINK).log()
    return parents.with_tensors(values)


def morton_order(means: Tensor) -> Tensor:
    """(N, 3) positions -> (N,) row numbers along a Z-order curve.

    Neighbours in space become neighbours in memory, which is good for the kernels' caches. Each
    axis has 10 bits between its 1st and 99th percentile, so that a few distant Gaussians do not
    reduce the resolution.
    """
    points = means.detach().double()
    if len(points) == 0:
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    low, high = _percentile(points, 0.01), _percentile(points, 0.99)
    unit = ((points - low) / (high - low).clamp(min=1e-12)).clamp(0, 1)
    cell = (unit * 1023).long()
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | (cell << shift)) & mask
    code = cell[:, 0] | (cell[:, 1] << 1) | (cell[:, 2] << 2)
    return torch.argsort(code, stable=True)


def _percentile(points: Tensor, share: float) -> Tensor:
    """(N, 3) -> (3,) quantile of each column at `share` (0 to 1), linearly interpolated."""
    position = share * (len(points) - 1)
    lower, upper = (
        points.kthvalue(int(k) + 1, dim=0).values for k in (position, -(-position // 1))
    )
    return lower + (upper - lower) * (position % 1)


def chosen_rows(matrix: Tensor, rows: Tensor) -> Tensor:
    """Copy rows of (N, ...), without gradient; `rows` are (M,) long row numbers, -1 for zeros."""
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
