"""Carries masks to other photos by votes on a trained model's Gaussians."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..context import QUIET, Context
from ..model.gaussians import SH_C0, Gaussians
from ..model.ownership import owners
from ..model.roi import OrientedBox
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import rasterize_view
from ..training.labels import MaskedView, mask_votes, object_rows
from .propagation import Knowledge, Prior, eroded
from .views import ON_BACKGROUND, ON_OBJECT, Mask, View

Votes = tuple[Tensor, Tensor]
EDGE = 0.03  # width of a mask's outline, in the object's size
HEARD = 1.0  # least sum of votes for a Gaussian to count, in pixels


class GaussianVotes(Knowledge):
    """The Gaussians of a box, with each photo's votes for and against them."""

    def __init__(
        self, model: Gaussians, roi: OrientedBox, rois: list[OrientedBox], context: Context = QUIET
    ) -> None:
        """Args: `model`, `roi`: in one frame; `rois`: all boxes, which share the Gaussians."""
        self._model = model
        self._context = context
        names = [each.name for each in rois]
        self._owned = owners(model, rois) == names.index(roi.name)
        self._votes: dict[str, Votes] = {}

    @property
    def is_empty(self) -> bool:
        """Whether the box has no Gaussian."""
        return not bool(self._owned.any())

    def learn_strokes(self, view: View) -> None:
        self._count(view, view.seeds == ON_OBJECT, view.seeds == ON_BACKGROUND, 1.0)

    def learn(self, view: View, mask: Mask, weight: float = 1.0) -> None:
        # Pixels at the outline do not vote: they also show a little of Gaussians on the far side.
        edge = max(2.0, EDGE * math.sqrt(mask.sum()))
        self._count(view, eroded(mask, edge), eroded(~mask, edge), weight)

    def _count(self, view: View, object_: Mask, background: Mask, weight: float) -> None:
        """Count pixels of a photo that show the object, and pixels that do not."""
        votes = []
        for mask in (object_, background):
            one = MaskedView(view.camera, view.world_to_camera, torch.from_numpy(mask))
            votes.append(weight * mask_votes(self._model, [one], self._context)[0])
        self._votes[view.name] = (votes[0], votes[1])

    def prior(self, view: View, *, without: bool = True) -> Prior:
        yes, no = self._sum(view.name if without else None)
        known = self._owned & (yes + no > 0)
        rows = object_rows(self._model, (yes, no), self._owned)
        shown = self._shown(view, torch.stack([rows, self._owned, self._owned & ~known]))
        return Prior(in_object=shown[0], in_box=shown[1], unknown=shown[2])

    def rows(self) -> Tensor:
        """(N,) bool: the object's Gaussians, by the votes of all photos."""
        return object_rows(self._model, self._sum(None), self._owned)

    def _sum(self, without: str | None) -> Votes:
        zero = torch.zeros(len(self._model), device=self._model.means.device)
        yes, no = zero, zero.clone()
        for name, pair in self._votes.items():
            if name != without:
                yes, no = yes + pair[0], no + pair[1]
        heard = (yes + no >= HEARD).to(yes)
        return heard * yes, heard * no

    @torch.no_grad()
    def _shown(self, view: View, groups: Tensor) -> NDArray[np.float32]:
        """(3, H, W) share of each pixel for three groups of Gaussians, (3, N) bool."""
        model = self._model
        colours = (groups.T.to(model.means) - 0.5) / SH_C0
        painted = model.with_tensors({"sh": colours[:, None].contiguous()})
        output = rasterize_view(
            painted, view.camera, view.world_to_camera, limits=PICTURE_LIMITS, background=None
        )
        return np.asarray(output.image[0].clamp(0, 1).permute(2, 0, 1).cpu().numpy())
