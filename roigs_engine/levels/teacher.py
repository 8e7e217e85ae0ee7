"""What a level learns from: the whole part, drawn small without aliasing.

Drawn small, a model is wrong: each Gaussian is widened to a pixel's size at least, so thin ones
grow and dense ones cover what is behind them. So the teacher is drawn with several samples per
pixel, about as finely as the photos show the part, and averaged. It is drawn alone, before black
and before white, so that a level learns what lets light through as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from ..rasterize.view import View, render_view
from .parts import Part, rate_of

MARGIN = 0.06  # around what the part covers, of its size
SMALLEST = 12  # pixels; smaller pictures of a part teach little
BLACK, WHITE = 0.0, 1.0


def views_at(part: Part, views: Sequence[View], coarser: float) -> list[View]:
    """The views at the size that shows the part `coarser` times as coarsely as its photos.

    Each is cropped to the part. Views that show it more coarsely as they are, or hardly, are left
    out.
    """
    found = []
    for camera, pose in views:
        rate = rate_of(part.probes, (camera, pose))
        factor = part.rate / (coarser * rate) if rate > 0 else math.inf
        if factor > 1 + 1e-6:
            continue
        window = _window(part, camera, pose)
        cropped = _cropped(camera, window, factor)
        if min(cropped.width, cropped.height) >= SMALLEST:
            found.append((cropped, pose))
    return found


def small_picture(gaussians: Gaussians, view: View, samples: int, background: float) -> Tensor:
    """(H, W, 3) of a model, with `samples` x `samples` samples per pixel of the view."""
    camera, pose = view
    large = camera.resized(camera.width * samples, camera.height * samples)
    colour = gaussians.means.new_full((3,), background)
    image = render_view(gaussians, large, pose, background=colour).image
    return image.reshape(camera.height, samples, camera.width, samples, 3).mean(dim=(1, 3))


def samples_for(coarser: float) -> int:
    """Samples per pixel and axis that show a part at least as finely as its photos."""
    return max(1, math.ceil(coarser - 1e-6))


class TeacherPictures:
    """The pictures of a part, as photos for the trainer; drawn once, kept as bytes."""

    def __init__(
        self,
        part: Part,
        views: Sequence[View],
        backgrounds: Sequence[float],
        coarser: float,
        context: Context = QUIET,
    ) -> None:
        """Args: `views` of `views_at` with `coarser`, and the background behind each."""
        device = torch.device(context.device)
        model, samples = part.gaussians.to(device), samples_for(coarser)
        self._pictures = []
        for view, background in zip(views, backgrounds, strict=True):
            context.check_cancelled()
            image = small_picture(model, view, samples, background)
            self._pictures.append((255 * image).round().to(torch.uint8).cpu().numpy())

    def __getitem__(self, index: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        return self._pictures[index]

    def __iter__(self) -> Iterator[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
        return iter(self._pictures)

    def prefetch(self, indices: Sequence[int]) -> None:
        """Nothing: all are there."""


def _window(part: Part, camera: Camera, pose: Float64) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1: the pixels that nearly all of the part's centres lie in, with a margin."""
    local = part.gaussians.means.double().numpy() @ pose[:3, :3].T + pose[:3, 3]
    local = local[local[:, 2] > 0]
    x = camera.fx * local[:, 0] / local[:, 2] + camera.cx
    y = camera.fy * local[:, 1] / local[:, 2] + camera.cy
    shown = (x >= 0) & (x <= camera.width) & (y >= 0) & (y <= camera.height)
    if not shown.any():
        return 0.0, 0.0, 0.0, 0.0
    (x0, x1), (y0, y1) = (np.quantile(v[shown], (0.005, 0.995)) for v in (x, y))
    wide, high = MARGIN * (x1 - x0) + 2, MARGIN * (y1 - y0) + 2
    return (
        max(0.0, x0 - wide),
        max(0.0, y0 - high),
        min(float(camera.width), x1 + wide),
        min(float(camera.height), y1 + high),
    )


def _cropped(camera: Camera, window: tuple[float, float, float, float], factor: float) -> Camera:
    """The camera of the window, `factor` times its size."""
    x0, y0, x1, y1 = window
    return Camera(
        width=int(factor * (x1 - x0)),
        height=int(factor * (y1 - y0)),
        fx=factor * camera.fx,
        fy=factor * camera.fy,
        cx=factor * (camera.cx - x0),
        cy=factor * (camera.cy - y0),
    )
