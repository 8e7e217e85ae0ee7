"""How much of a view each Gaussian fills, and how far it is from the scene and the cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...context import QUIET, Context
from ...model.gaussians import Gaussians
from ...model.scene import Float64, PosedImage
from ...rasterize.view import View, blending_weights

SIDE = 256  # pixels; shares of a view need no more
NEAREST = 0.25  # least distance of a view from the scene, in distances of the photos near it
MORE = NEAREST**-2  # how much more of a view than of any photo is too much
LEAST = 1e-3  # share of a view that is worth a look
FAINT = 1 / 255  # of a pixel's light: less is not shown
POINTS = 10  # so many points nearer than a distance mean that the scene is there, not a stray


@torch.no_grad()
def largest_shares(gaussians: Gaussians, views: Iterable[View], context: Context = QUIET) -> Tensor:
    """(N,) the largest share of a view's light that each Gaussian has, 0 to 1.

    Args:
        gaussians: the model, N rows.
        views: to look from.
        context: checked for cancellation between views.
    """
    views = list(views)
    largest = torch.zeros(len(gaussians), device=gaussians.means.device)
    for (camera, _), weights in zip(
        views, blending_weights(gaussians, views, context), strict=True
    ):
        torch.maximum(largest, weights.total / (camera.width * camera.height), out=largest)
    return largest


def photo_views(images: Sequence[PosedImage]) -> list[View]:
    """The photos' own views, small."""
    return [(image.camera.thumbnail(SIDE), image.world_to_camera) for image in images]


def shown_by(
    gaussians: Gaussians, images: Sequence[PosedImage], context: Context = QUIET
) -> Tensor:
    """(N,) bool: which Gaussians the photos show: those that have some light of a view."""
    shares = largest_shares(gaussians, photo_views(images), context)
    return shares > FAINT / SIDE**2


def reach(places: Float64, points: Float64) -> Float64:
    """(N, 3) -> (N,) distances to the scene: to its tenth nearest point; infinite: no points."""
    if len(points) == 0:
        return np.full(len(places), np.inf)
    distances, _ = cKDTree(points).query(places, k=[min(POINTS, len(points))])
    return np.asarray(distances[:, 0])


def in_the_air(
    gaussians: Gaussians, images: Sequence[PosedImage], points: Float64, times: float
) -> Tensor:
    """(N,) bool: whose centres are so many times nearer to a photo's camera than to the scene.

    Nothing is where there are no points.
    """
    device = gaussians.means.device
    if len(points) == 0:
        return torch.zeros(len(gaussians), dtype=torch.bool, device=device)
    means = gaussians.means.detach().cpu().numpy().astype(np.float64)
    distance, _ = cKDTree([image.centre for image in images]).query(means)
    return torch.from_numpy(times * distance < reach(means, points)).to(device)
