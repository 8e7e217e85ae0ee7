"""The photos of a stage in one size, on its device, with their cameras and masks."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..cuda.photos import photos_on
from .cameras import camera_tensors
from .stage_data import SmallPhotos, StageData


class View(NamedTuple):
    """A camera as the rasterizer takes it: (1, 4, 4) and (1, 3, 3) matrices, pixels.

    `pixel_size` is the side of a pixel in pixels of the whole photo.
    """

    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int
    pixel_size: float


class PhotoViews:
    """The photos of a stage in one size.

    Attributes: `images`: with the cameras of that size.

    Args:
        of: the photos, in their size.
        device: that trains.
        limit: bytes of a GPU that they may take; None: a share of what is free.
    """

    def __init__(
        self, of: StageData | SmallPhotos, device: torch.device, limit: int | None
    ) -> None:
        self.images = of.images
        self._sizes = [(image.camera.width, image.camera.height) for image in of.images]
        self._photos = photos_on(device, of.photos, limit)
        self._viewmats, self._intrinsics = camera_tensors(of.images, device)
        self._pixel_sizes = [image.pixel_size for image in of.images]

    def photo(self, index: int) -> Tensor:
        """Its pixels, as `PhotoTensors` has them."""
        return self._photos[index]

    def prefetch(self, index: int) -> None:
        """Decode a photo in the background."""
        self._photos.prefetch([index])

    def view(self, index: int) -> View:
        """Its camera."""
        one = slice(index, index + 1)
        return View(
            self._viewmats[one],
            self._intrinsics[one],
            *self._sizes[index],
            self._pixel_sizes[index],
        )
