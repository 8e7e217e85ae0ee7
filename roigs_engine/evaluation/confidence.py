"""Confidence of each Gaussian (ours): photos, directions, and colour error.

A photo shows a Gaussian if its alpha x T is 1/255 or more on some pixel. The photo's direction is
the nearest of 128 that are evenly distributed on the sphere, about 18 degrees apart. The error
comes from held-out photos:

    error_i = sqrt(sum_p w_i(p) e(p)^2 / sum_p w_i(p))

over the pixels p of held-out photos that show i. w_i(p) = alpha x T is its weight, and e(p) the
difference of picture and photo. So each pixel's error is assigned to the Gaussians in the pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.confidence import COLUMNS
from ..model.gaussians import Gaussians
from ..model.scene import PosedImage
from ..photos.decode import load_photo
from ..photos.mask_images import load_mask
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import blending_weights, render_view
from ..selection.coverage import fibonacci_directions, nearest_direction
from ..training.floaters import FAINT
from ..training.losses import clipped_like
from .metrics import squared_error

DIRECTIONS = 128
WORD = 64  # directions per integer in a Gaussian's bit set

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Confidence:
    """Confidence of N Gaussians.

    Attributes:
        photos: (N,) number of training photos that show each Gaussian.
        directions: (N,) number of the `DIRECTIONS` from which they show it.
        error: (N,) root mean square error of its colours in held-out photos, 0 to 1; NaN if none
            shows it.
    """

    photos: Float32
    directions: Float32
    error: Float32

    @property
    def columns(self) -> dict[str, Float32]:
        """Return name -> values, for a PLY."""
        return dict(zip(COLUMNS, (self.photos, self.directions, self.error), strict=True))


def confidence(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    held_out: Sequence[PosedImage],
    context: Context = QUIET,
) -> Confidence:
    """Compute the confidence of each Gaussian of a model.

    Args:
        gaussians: the model, in the frame of the photos.
        images: its training photos; their pixels are not used.
        held_out: photos that were not used for training.
        context: checked for cancellation.

    PhotoError, MaskError: a held-out photo cannot be read.
    """
    photos, directions = _seen(gaussians, images, context)
    return Confidence(
        photos=photos, directions=directions, error=_errors(gaussians, held_out, context)
    )


def _seen(
    gaussians: Gaussians, images: Sequence[PosedImage], context: Context
) -> tuple[Float32, Float32]:
    """(N,) number of photos that show each Gaussian, and (N,) number of their directions."""
    means = gaussians.means.detach().cpu().numpy().astype(np.float64)
    even = fibonacci_directions(DIRECTIONS)
    photos = np.zeros(len(means), np.int64)
    sets = np.zeros((len(means), DIRECTIONS // WORD), np.uint64)
    views = [(image.camera, image.world_to_camera) for image in images]
    every = blending_weights(gaussians, views, context, limits=PICTURE_LIMITS)
    for image, weights in zip(images, every, strict=True):
        rows = np.flatnonzero((weights.largest >= FAINT).cpu().numpy())
        ways = image.centre - means[rows]
        ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
        nearest = nearest_direction(ways, even) if len(rows) else np.zeros(0, np.int64)
        photos[rows] += 1
        sets[rows, nearest // WORD] |= np.uint64(1) << (nearest % WORD).astype(np.uint64)
    bits = np.arange(WORD, dtype=np.uint64)
    count = sum(((sets >> bit) & np.uint64(1)).sum(axis=1) for bit in bits)
    return photos.astype(np.float32), np.asarray(count, np.float32)


@torch.no_grad()
def _errors(gaussians: Gaussians, held_out: Sequence[PosedImage], context: Context) -> Float32:
    """(N,) error of each Gaussian in held-out photos; NaN if none shows it."""
    device = gaussians.means.device
    wrong = torch.zeros(len(gaussians), dtype=torch.float64, device=device)
    light = torch.zeros_like(wrong)
    for image in held_out:
        context.check_cancelled()
        counted = load_mask(image)
        photo = torch.from_numpy(load_photo(image)).to(device) / 255.0
        view = render_view(gaussians, image.camera, image.world_to_camera)
        picture = clipped_like(view.image, image)
        mask = torch.ones(photo.shape[:2], device=device)
        if counted is not None:
            mask = torch.from_numpy(counted).to(mask)
        views = [(image.camera, image.world_to_camera)] * 2
        parts = (squared_error(picture, photo) * mask, mask)
        of_error, of_light = blending_weights(
            gaussians, views, context, limits=PICTURE_LIMITS, pixels=parts
        )
        shown = of_light.largest >= FAINT
        wrong += torch.where(shown, of_error.total, 0.0)
        light += torch.where(shown, of_light.total, 0.0)
    found = torch.where(light > 0, wrong / light, torch.nan).sqrt()
    return found.cpu().numpy().astype(np.float32)
