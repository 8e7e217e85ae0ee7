"""Density control with rules for boxes (ROI-GS, sec. II-B): thresholds and budgets of their own."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...model.gaussians import Gaussians
from ...model.ownership import owners
from .adaptive import AdaptiveDensity

NEAR = 2.0  # diagonals of a box; what is as near is seen with its object, and from as near


class InBoxDensity(AdaptiveDensity):
    """3DGS with up to three rules: densify less outside, or only in boxes; a threshold; budgets."""

    def densify_mask(self, gaussians: Gaussians, step: int) -> Tensor:
        """(N,) bool; if a box's budget is too small for all, the largest gradients go first."""
        config, gradient = self.config, self.stats.mean_gradient()
        mask = gradient > config.grad_threshold
        owner = owners(gaussians, self.inputs.rois)
        if config.box_grad_threshold:
            mask = torch.where(owner >= 0, gradient > config.box_grad_threshold, mask)
        if config.densify_in_boxes:
            mask = torch.where(owner >= 0, mask, gradient > self._outside_thresholds(gaussians))
        progress = step / config.densify_until
        for index, budget in enumerate(self.inputs.budgets or ()):
            mine = torch.nonzero(mask & (owner == index)).flatten()
            room = max(0, budget.at(progress) - int((owner == index).sum()))
            if len(mine) > room:
                order = torch.argsort(gradient[mine], descending=True, stable=True)
                mask[mine[order[room:]]] = False
        return mask

    def _outside_thresholds(self, gaussians: Gaussians) -> Tensor:
        """(N,) gradient thresholds outside the boxes, by the distance from the nearest box."""
        far = self.config.outside_grad_threshold or np.inf
        near = self.config.near_grad_threshold or far
        thresholds = np.full(len(gaussians), far)
        if near < far < np.inf:
            centres = gaussians.means.detach().cpu().double().numpy()  # as in `owners`
            for roi in self.inputs.rois:
                share = roi.distance(centres) / (NEAR * roi.diagonal)
                thresholds = np.fmin(thresholds, near + (far - near) * share)
        return torch.from_numpy(thresholds.astype(np.float32)).to(gaussians.means.device)

    def size_reference(self, gaussians: Gaussians) -> Tensor:
        """(N,) the scene's extent; in a box at most the box's diagonal, world units.

        The extent of the box's own photos is not used: it would split or prune the background.
        """
        reference = super().size_reference(gaussians)
        if self.config.densify_in_boxes:
            owner = owners(gaussians, self.inputs.rois)
            for index, roi in enumerate(self.inputs.rois):
                reference[owner == index] = min(self.inputs.extent, roi.diagonal)
        return reference
