"""Gaussians that the photos hardly show (ours).

Densification leaves many Gaussians behind others, or nearly transparent; some scenes have twice as
many as they need. When it ends, the faintest are removed, as many as the photos do not miss: their
squared error may grow by a share, which the steps that follow make up for. Nothing else says how
many there are: that differs from scene to scene (docs/lab_notebook.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..cuda.library import has_blending_weights
from ..cuda.sending import sent
from ..model.gaussians import Gaussians
from ..model.scene import PosedImage
from ..rasterize import rasterize
from ..rasterize.view import rasterize_view
from .masks import split_mask
from .photo_views import PhotoViews

PROBES = 24  # photos that are asked, evenly spaced in the stage's
MOST = 0.9  # share of the Gaussians that may go
HALVINGS = 5  # of that range: to 3 % of the Gaussians

Errors = tuple[float, ...]


@torch.no_grad()
def visible_worth(
    gaussians: Gaussians, images: Sequence[PosedImage], context: Context = QUIET
) -> Tensor:
    """(N,) about how much the photos' squared error depends on each Gaussian.

    The sum over photos of its largest blending weight times the sum of its weights, which is an
    upper bound of the sum of its squared weights; photos in half their size.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not used.
        context: checked for cancellation between photos.
    """
    device = gaussians.means.device
    model = gaussians if has_blending_weights(device) else gaussians.to(CPU)
    worth = torch.zeros(len(model), dtype=torch.float64, device=model.means.device)
    for image in images:
        context.check_cancelled()
        camera = image.camera.thumbnail(max(image.camera.width, image.camera.height) // 2)
        output = rasterize_view(
            model,
            camera,
            image.world_to_camera,
            sh_degree=0,  # colours do not matter
            with_max_weight=True,
            with_weight_sum=True,
        )
        assert output.weight_sum is not None and output.max_weight is not None
        worth += output.weight_sum * output.max_weight
    return worth.to(device)


class PhotoErrors:
    """The mean squared errors of a model on some of the photos that it trains on.

    Args:
        views: the photos.
        count: of the photos.
        backgrounds: (count, 3) colours behind everything; None: black.
        context: checked for cancellation between photos.
    """

    def __init__(
        self, views: PhotoViews, count: int, backgrounds: Tensor | None, context: Context = QUIET
    ) -> None:
        self._views, self._backgrounds, self._context = views, backgrounds, context
        places = np.linspace(0, count - 1, min(PROBES, count)).round()
        self._photos = [int(place) for place in places]

    @torch.no_grad()
    def __call__(self, gaussians: Gaussians) -> Errors:
        """The error on all pixels that count, and that on the pixels of the boxes' masks.

        The second is left out where no photo has a mask.
        """
        sums = {"whole": [0.0, 0.0], "masks": [0.0, 0.0]}
        for index in self._photos:
            self._context.check_cancelled()
            squares, counted = self._squares(gaussians, index)
            mask = self._views.mask(index)
            parts = {"whole": counted}
            if mask is not None:
                parts["masks"] = counted & sent(mask.pixels, counted.device)
            for part, pixels in parts.items():
                sums[part][0] += float(squares[pixels].sum(dtype=torch.float64))
                sums[part][1] += float(pixels.sum())
        return tuple(error / pixels for error, pixels in sums.values() if pixels)

    def _squares(self, gaussians: Gaussians, index: int) -> tuple[Tensor, Tensor]:
        """(H, W) squared errors, and (H, W) bool: which pixels count."""
        photo, counted = split_mask(self._views.photo(index))
        output = rasterize(
            *gaussians.tensors().values(),
            **self._views.view(index)._asdict(),
            raw=True,
            antialiased=gaussians.antialiased,
            background=None if self._backgrounds is None else self._backgrounds[index],
        )
        squares = (output.image[0] - photo / 255.0).square().mean(dim=-1)
        return squares, torch.ones_like(squares, dtype=torch.bool) if counted is None else counted


def faintest(worth: Tensor, errors: Callable[[Tensor], Errors], growth: float) -> Tensor:
    """(N,) bool: the Gaussians of the least worth, as many as may go.

    Args:
        worth: (N,) of each.
        errors: of the model with some of its rows, (N,) bool.
        growth: largest growth of any of these errors, as a share of it.
    """
    order = worth.argsort(stable=True)
    order = order[worth[order] > 0]  # what no photo shows, the photos cannot judge

    def least(share: float) -> Tensor:
        found = torch.zeros(len(worth), dtype=torch.bool, device=worth.device)
        found[order[: int(share * len(order))]] = True
        return found

    before = errors(~least(0.0))
    few, many = 0.0, MOST
    for _ in range(HALVINGS):
        share = (few + many) / 2
        after = errors(~least(share))
        holds = all(b <= (1 + growth) * a for a, b in zip(before, after, strict=True))
        few, many = (share, many) if holds else (few, share)
    return least(few)
