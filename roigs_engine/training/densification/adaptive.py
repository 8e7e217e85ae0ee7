"""3DGS's adaptive density control (Kerbl et al. 2023, sec. 5.2).

Gaussians with a large mean 2D gradient are cloned or split, transparent and huge ones are pruned,
and opacities are reset periodically. ROI-GS also prunes Gaussians that contribute to no training
pixel of a window of steps (sec. II-B).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...model.gaussians import Gaussians
from ..z_order import morton_order
from .edits import Edit, clone_and_split, unchanged
from .interface import DensityInputs
from .statistics import DensityStats

VISIBLE_WEIGHT = 1 / 255  # alpha x T below which a Gaussian cannot change an 8-bit pixel
RESET_OPACITY = 0.01


class AdaptiveDensity:
    """See the module. Subclasses override which Gaussians are densified, and the size reference."""

    def __init__(self, inputs: DensityInputs, count: int) -> None:
        """Start with empty statistics of `count` Gaussians."""
        self.inputs, self.config = inputs, inputs.config
        self.stats = DensityStats.zeros(count, inputs.device)
        self._window = 0  # the step at which the current window began

    @property
    def needs_max_weight(self) -> bool:
        """Only pruning by contribution needs it."""
        return self.config.contribution_every > 0

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Add the statistics of one training view; all arguments (N,)."""
        self.stats.add(visible, grad2d, max_weight)

    def is_due(self, step: int) -> bool:
        """Whether to densify, to prune or to reset after `step` steps."""
        return self._densifies(step) or self._ends_window(step) or self._resets(step)

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """Densify, prune and reset, as far as due after `step` steps."""
        edit = Edit(gaussians=gaussians, rows=None)
        if self._densifies(step):
            edit = self._densified(gaussians, step)
            assert edit.rows is not None
            self.follow(edit.rows)
        if self._ends_window(step):
            edit = self._prune_idle(edit)
            self.stats.new_window()
            self._window = step
        if self._resets(step):
            edit = replace(edit, opacity_cap=RESET_OPACITY)
        return None if edit.rows is None and edit.opacity_cap is None else edit

    def _grows(self, step: int) -> bool:
        return self.config.densify_from <= step < self.config.densify_until

    def _densifies(self, step: int) -> bool:
        return self._grows(step) and step % self.config.densify_every == 0

    def _resets(self, step: int) -> bool:
        every = self.config.reset_every
        return self._grows(step) and every > 0 and step % every == 0

    def _ends_window(self, step: int) -> bool:
        every = self.config.contribution_every
        return every > 0 and step - self._window >= self._window_steps()

    def follow(self, rows: Tensor) -> None:
        """Carry the statistics over to edited rows; gradient sums restart at zero."""
        self.stats = self.stats.after(rows)

    def densify_mask(self, gaussians: Gaussians, step: int) -> Tensor:
        """(N,) bool: which Gaussians to clone or split."""
        return self.stats.mean_gradient() > self.config.grad_threshold

    def size_reference(self, gaussians: Gaussians) -> Tensor:
        """(N,) the length that `split_fraction` is relative to: the scene's extent."""
        device = gaussians.means.device
        return torch.full((len(gaussians),), self.inputs.extent, device=device)

    def _densified(self, gaussians: Gaussians, step: int) -> Edit:
        rng = torch.Generator().manual_seed(self.inputs.seed * 1_000_003 + step)
        mask, reference = self.densify_mask(gaussians, step), self.size_reference(gaussians)

        def choose(edited: Gaussians) -> Tensor:
            rows = self.prune_mask(edited, step).logical_not().nonzero()[:, 0]
            return rows[morton_order(edited.means[rows])]

        return clone_and_split(gaussians, mask, reference, self.config.split_fraction, rng, choose)

    def prune_mask(self, gaussians: Gaussians, step: int) -> Tensor:
        """(N,) bool: too transparent or, after the first opacity reset, too large in the world."""
        config = self.config
        keep = gaussians.logit_opacities.detach().sigmoid() >= config.prune_opacity
        if config.reset_every and step > config.reset_every:
            largest = gaussians.log_scales.detach().exp().amax(dim=1)
            keep &= largest <= config.prune_size * self.inputs.extent
        return ~keep

    def _prune_idle(self, edit: Edit) -> Edit:
        """Drop Gaussians that contributed to no training pixel of the window (ROI-GS, II-B)."""
        keep = self.stats.weight >= VISIBLE_WEIGHT
        if bool(keep.all()):
            return edit
        kept = keep.nonzero()[:, 0]
        self.follow(kept)
        return (unchanged(edit.gaussians) if edit.rows is None else edit).keep(kept)

    def _window_steps(self) -> int:
        """Steps of a window, enough to include every photo: a Gaussian must be idle on all."""
        return max(self.config.contribution_every, 2 * self.inputs.photos)

    def state_dict(self) -> dict[str, Any]:
        """The statistics, and the step at which the window began."""
        stats = self.stats
        return {
            "window": self._window,
            "stats": {"gradient": stats.gradient, "views": stats.views, "weight": stats.weight},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self._window = int(state["window"])
        self.stats = DensityStats(**state["stats"])
