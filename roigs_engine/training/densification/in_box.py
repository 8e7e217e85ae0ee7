"""Density control with rules for boxes (ROI-GS, sec. II-B): thresholds and budgets of their own."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...model.gaussians import Gaussians
from ...model.ownership import owners
from .adaptive import AdaptiveDensity

NEAR = 2.0  # diagonals of a box: what is nearer is in the same close-ups as its object


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
            mask = torch.where(owner >= 0, mask, self._outside(gaussians, gradient, owner))
        progress = step / config.densify_until
        for index, budget in enumerate(self.inputs.budgets or ()):
            mine = torch.nonzero(mask & (owner == index)).flatten()
            room = max(0, budget.at(progress) - int((owner == index).sum()))
            if len(mine) > room:
                order = torch.argsort(gradient[mine], descending=True, stable=True)
                mask[mine[order[room:]]] = False
        return mask

    def _outside(self, gaussians: Gaussians, gradient: Tensor, owner: Tensor) -> Tensor:
        """(N,) bool: which Gaussians outside the boxes are densified.

        The threshold of each follows from its distance from the boxes, in diagonals of each; the
        lowest counts.
        """
        far = self.config.outside_grad_threshold or torch.inf
        near = self.config.near_grad_threshold or far
        dense = gradient > far
        if not near < far < torch.inf:
            return dense
        asked = ((gradient > near) & ~dense & (owner < 0)).nonzero()[:, 0]
        centres = gaussians.means.detach()[asked].cpu().double().numpy()  # there, as in `owners`
        share = np.ones(len(asked))
        for roi in self.inputs.rois:
            share = np.fmin(share, roi.distance(centres) / (NEAR * roi.diagonal))
        thresholds = torch.from_numpy(near + (far - near) * share).to(gradient)
        dense[asked] = gradient[asked] > thresholds
        return dense

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
