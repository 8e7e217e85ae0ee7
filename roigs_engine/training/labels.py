"""Labels the Gaussians of an object, by votes of the object's masks on some photos.

A Gaussian belongs to the object if most votes are for it. This is the closed-form optimum of
fitting binary labels to the masks (FlashSplat, Shen et al. 2024; docs/method.md, "Objects by
masks").
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.ownership import owners
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage
from ..photos.mask_images import load_mask, load_object_mask
from ..rasterize.view import blending_weights


class MaskedView(NamedTuple):
    """A photo with a mask of the object."""

    camera: Camera
    world_to_camera: Float64
    mask: Tensor  # (H, W) bool, the object's pixels
    counted: Tensor | None = None  # (H, W) bool, the pixels that vote; None for all


LEAST = 1 / 255  # sum of votes below which a Gaussian counts as not shown by any photo
AROUND = 5  # neighbours that decide the label of such a Gaussian


@torch.no_grad()
def mask_votes(
    gaussians: Gaussians, views: Iterable[MaskedView], context: Context = QUIET
) -> tuple[Tensor, Tensor]:
    """(N,) twice: the votes of all views for, and against, each Gaussian being part of the object.

    `gaussians` are the whole model, N rows, because other Gaussians hide those behind them.
    """
    means = gaussians.means
    inside, everywhere = (torch.zeros(len(gaussians), device=means.device) for _ in range(2))
    for camera, pose, mask, counted in views:
        yes = mask if counted is None else mask & counted
        twice, pixels = [(camera, pose)] * 2, (yes, counted)
        shares = blending_weights(gaussians, twice, context, pixels=pixels)
        for total, weights in zip((inside, everywhere), shares, strict=True):
            total += weights.total
    return inside, (everywhere - inside).clamp(min=0)


def object_rows(gaussians: Gaussians, votes: tuple[Tensor, Tensor], candidates: Tensor) -> Tensor:
    """(N,) bool: the object's Gaussians, by `mask_votes`; `candidates` are those of its box."""
    yes, no = votes
    rows, seen = (yes > no) & candidates, (yes + no >= LEAST) & candidates
    unseen = candidates & ~seen
    if not bool(seen.any()) or not bool(unseen.any()):
        return rows & seen
    places = gaussians.means.detach().cpu().numpy()
    known, asked = seen.cpu().numpy(), unseen.cpu().numpy()
    count = min(AROUND, int(known.sum()))
    _, near = cKDTree(places[known]).query(places[asked], k=list(range(1, count + 1)))
    share = rows.cpu().numpy()[known][near].mean(axis=1)
    found = (rows & seen).cpu().numpy()
    found[asked] = share > 0.5
    return torch.from_numpy(np.ascontiguousarray(found)).to(rows.device)


def masked_views(images: Iterable[PosedImage], box: str) -> Iterator[MaskedView]:
    """Yield the photos with a mask of the box's object; raises as `load_mask` does."""
    for image in images:
        mask = load_object_mask(image, box)
        if mask is not None:
            ignored = load_mask(image)
            counted = None if ignored is None else torch.from_numpy(ignored)
            shown = torch.from_numpy(np.ascontiguousarray(mask))
            yield MaskedView(image.camera, image.world_to_camera, shown, counted)


def object_owners(
    gaussians: Gaussians,
    rois: Sequence[OrientedBox],
    images: Sequence[PosedImage],
    context: Context = QUIET,
) -> Tensor:
    """(N,) index of the box whose object each Gaussian belongs to, -1 for none.

    Unlike `owners`, a box owns only the Gaussians of its object. A box without masks owns all.
    """
    owner = owners(gaussians, rois)
    for index, roi in enumerate(rois):
        if any(roi.name in image.objects for image in images):
            owned = owner == index
            votes = mask_votes(gaussians, masked_views(images, roi.name), context)
            owner[owned & ~object_rows(gaussians, votes, owned)] = -1
    return owner
