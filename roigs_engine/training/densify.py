"""Adaptive density control (Kerbl et al. 2023, sec. 5.2), confined to boxes in the ROI stage.

Free functions: parameters and statistics in, an `Edit` out, which says for each new row where it
came from, so that the optimiser's state can follow. Random numbers come from the caller's
generator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from .config import TrainConfig

SPLIT_SHRINK = 1.6  # 3DGS: children of a split have their scales divided by this
VISIBLE_WEIGHT = 1 / 255  # alpha x T below which a Gaussian cannot change an 8-bit pixel


@dataclass
class DensityStats:
    """What training has seen of each Gaussian since the last edit.

    Attributes:
        gradient: (N,) sum of 2D gradient norms (`RenderOutput.grad2d`).
        views: (N,) number of views that saw it.
        weight: (N,) largest alpha x T on any training pixel of the present window; infinite for
            Gaussians born in it, which not every photo has seen yet.
    """

    gradient: Tensor
    views: Tensor
    weight: Tensor

    @classmethod
    def zeros(cls, count: int, device: torch.device | None = None) -> DensityStats:
        """Statistics of `count` Gaussians that nothing has seen."""
        return cls(*(torch.zeros(count, device=device) for _ in range(3)))

    def add(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Take one training view in; all arguments (N,)."""
        self.gradient += grad2d
        self.views += visible
        if max_weight is not None:
            torch.maximum(self.weight, max_weight, out=self.weight)

    def mean_gradient(self) -> Tensor:
        """(N,) mean gradient norm over the views that saw each Gaussian."""
        return self.gradient / self.views.clamp(min=1)

    def after(self, rows: Tensor) -> DensityStats:
        """Statistics for edited Gaussians: gradients start anew, weights follow their rows."""
        fresh = DensityStats.zeros(len(rows), rows.device)
        fresh.weight = torch.where(rows >= 0, self.weight[rows.clamp(min=0)], torch.inf)
        return fresh

    def new_window(self) -> None:
        """Begin to measure the weights anew."""
        self.weight.zero_()


@dataclass(frozen=True, kw_only=True, eq=False)
class Edit:
    """Edited Gaussians.

    Attributes:
        gaussians: (M rows).
        rows: (M,) the row each came from with its optimiser state, -1 for a newborn.
    """

    gaussians: Gaussians
    rows: Tensor


def box_owner(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> Tensor:
    """(N,) index of the box that owns each Gaussian's centre, -1 for none.

    `roi.nearest_owner` on the model's device.
    """
    centres = gaussians.means.detach().double()
    owner = torch.full((len(centres),), -1, device=centres.device)
    best = torch.full_like(centres[:, 0], torch.inf)
    for index, roi in enumerate(rois):
        pose = torch.from_numpy(roi.world_to_box).to(centres)
        half_extents = torch.from_numpy(roi.half_extents).to(centres)
        local = (centres @ pose[:3, :3].T + pose[:3, 3]) / half_extents
        distance = local.norm(dim=1)
        mine = (local.abs() <= 1).all(dim=1) & (distance < best)
        owner[mine] = index
        best = torch.where(mine, distance, best)
    return owner


def size_reference(
    gaussians: Gaussians, config: TrainConfig, rois: Sequence[OrientedBox], extent: float
) -> Tensor:
    """(N,) the length that `split_fraction` refers to: the scene's extent or the box's diagonal.

    A close-up's own extent is never used: it would split or delete the background.
    """
    reference = torch.full((len(gaussians),), extent, device=gaussians.means.device)
    if config.densify_in_boxes:
        owner = box_owner(gaussians, rois)
        for index, roi in enumerate(rois):
            reference[owner == index] = min(extent, roi.diagonal)
    return reference


def choose(
    gaussians: Gaussians,
    stats: DensityStats,
    config: TrainConfig,
    rois: Sequence[OrientedBox],
    capacities: Sequence[int] | None,
) -> Tensor:
    """(N,) bool: which Gaussians to clone or split.

    Args:
        gaussians, stats, config: as trained so far.
        rois: the boxes, when the config has rules for them.
        capacities: most Gaussians each box may hold; the largest gradients win. None: no limit.
    """
    gradient = stats.mean_gradient()
    chosen = gradient > config.grad_threshold
    if not (config.densify_in_boxes or config.box_grad_threshold or capacities):
        return chosen
    owner = box_owner(gaussians, rois)
    if config.box_grad_threshold:
        chosen = torch.where(owner >= 0, gradient > config.box_grad_threshold, chosen)
    if config.densify_in_boxes:
        chosen &= owner >= 0
    for index, capacity in enumerate(capacities or ()):
        mine = torch.nonzero(chosen & (owner == index)).flatten()
        room = max(0, capacity - int((owner == index).sum()))
        if len(mine) > room:
            order = torch.argsort(gradient[mine], descending=True, stable=True)
            chosen[mine[order[room:]]] = False
    return chosen


def grow(
    gaussians: Gaussians, chosen: Tensor, reference: Tensor, fraction: float, rng: torch.Generator
) -> Edit:
    """Clone the small and split the large of the chosen Gaussians.

    A clone stays beside its original; a split Gaussian is replaced by two that are drawn from it.

    Args:
        gaussians: N rows.
        chosen: (N,) bool.
        reference: (N,) lengths, see `size_reference`.
        fraction: of the reference above which a Gaussian is split.
        rng: draws the positions of split ones.
    """
    large = gaussians.log_scales.detach().exp().amax(dim=1) > fraction * reference
    kept = torch.nonzero(~(chosen & large)).flatten()
    clones = torch.nonzero(chosen & ~large).flatten()
    parents = torch.nonzero(chosen & large).flatten().repeat(2)
    children = _children(gaussians.rows(parents), rng)
    edited = Gaussians.concatenate([gaussians.rows(torch.cat([kept, clones])), children])
    newborn = kept.new_full((len(clones) + len(parents),), -1)
    return Edit(gaussians=edited, rows=torch.cat([kept, newborn]))


def _children(parents: Gaussians, rng: torch.Generator) -> Gaussians:
    """Each parent moved to a sample of itself and shrunk."""
    scales = parents.log_scales.exp()
    # drawn on the CPU: the same numbers on every device
    offsets = torch.randn(scales.shape, generator=rng).to(scales.device) * scales
    means = parents.means + (rotation_matrices(parents.quats) @ offsets[..., None])[..., 0]
    values = parents.tensors()
    values["means"] = means
    values["log_scales"] = (scales / SPLIT_SHRINK).log()
    return Gaussians(**values)


def rotation_matrices(quats: Tensor) -> Tensor:
    """(N, 4) quaternions wxyz -> (N, 3, 3)."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)


def worth_keeping(gaussians: Gaussians, config: TrainConfig, extent: float, step: int) -> Tensor:
    """(N,) bool: opaque enough and, once opacities were reset, not too large in the world."""
    keep = gaussians.logit_opacities.detach().sigmoid() >= config.prune_opacity
    if config.reset_every and step > config.reset_every:
        largest = gaussians.log_scales.detach().exp().amax(dim=1)
        keep &= largest <= config.prune_size * extent
    return keep


def keep_rows(edit: Edit, keep: Tensor) -> Edit:
    """The edit with only some of its rows: a boolean mask (M,) or row numbers in a new order."""
    return Edit(gaussians=edit.gaussians.rows(keep), rows=edit.rows[keep])


def unchanged(gaussians: Gaussians) -> Edit:
    """The edit that changes nothing."""
    rows = torch.arange(len(gaussians), device=gaussians.means.device)
    return Edit(gaussians=gaussians, rows=rows)


def morton_order(means: Tensor) -> Tensor:
    """(N, 3) positions -> (N,) row numbers along a Z-order curve.

    Neighbours in space become neighbours in memory, which the kernels' caches like. 10 bits an axis
    between the 1st and 99th percentile: a few far Gaussians must not use the resolution up.
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
    """(N, 3) -> (3,) value below which this share of each column lies, between two rows."""
    position = share * (len(points) - 1)
    lower, upper = (
        points.kthvalue(int(k) + 1, dim=0).values for k in (position, -(-position // 1))
    )
    return lower + (upper - lower) * (position % 1)
