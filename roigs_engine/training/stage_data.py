"""The training data of a stage, with its photos on the training device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..cuda.device import CPU
from ..cuda.photos import Photos, photos_on
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from ..rasterize.view import SAME_FOCAL
from .photo_order import PhotoAt


@dataclass(frozen=True, kw_only=True, eq=False)
class StageData:
    """The training data of a stage.

    Attributes:
        images: posed photos.
        photos: their pixels, in the same order.
        photo_at: step -> position in `images` of the photo that the step uses.
        extent: the *scene's* extent, world units; scales position learning rates and pruning sizes.
        rois: the boxes.
        labelled: returns the stage's first model, and the index of the box that owns each of its
            Gaussians, or -1. Object masks decide where there are any.
        points: (P, 3) of the scene, world units.
        backgrounds: (photos, 3) colour behind all Gaussians of each photo, on `device`; None for
            black.
        seed: for the positions of split Gaussians.
        device: for training; devices differ only in rounding.
        card_photos: bytes of photos to keep on a GPU; None for a share of its free memory.
    """

    images: Sequence[PosedImage]
    photos: Photos
    photo_at: PhotoAt
    extent: float
    rois: Sequence[OrientedBox] = ()
    labelled: Callable[[], tuple[Gaussians, Tensor]] | None = None
    points: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    backgrounds: Tensor | None = None
    seed: int = 0
    device: torch.device = CPU
    card_photos: int | None = None

    @property
    def photo_focal(self) -> float | None:
        """Return the focal length of the whole photos, pixels; None if they differ, or without any.

        A stage draws each photo with its own pixels, so there may be no common focal length.
        """
        focals = [image.camera.focal * image.pixel_size for image in self.images]
        if not focals or max(focals) > (1 + SAME_FOCAL) * min(focals):
            return None
        return float(f"{np.median(focals):.6g}")  # the same for photos of half the size


class View(NamedTuple):
    """A camera in the rasterizer's form: (1, 4, 4) and (1, 3, 3) matrices, pixels.

    `pixel_size` is the side of a pixel in pixels of the whole photo.
    """

    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int
    pixel_size: float


class PhotoViews:
    """The photos of a stage in one size, on the device; `limit` is as `StageData.card_photos`."""

    def __init__(self, of: StageData, device: torch.device, limit: int | None) -> None:
        self.images = of.images
        self._photos = photos_on(device, of.photos, limit)
        poses = np.stack([image.world_to_camera for image in of.images])
        intrinsics = np.stack([image.camera.matrix() for image in of.images])
        self._viewmats, self._intrinsics = (
            torch.from_numpy(matrices.astype(np.float32)).to(device)
            for matrices in (poses, intrinsics)
        )

    def photo(self, index: int) -> Tensor:
        """Return the photo's pixels, in the form of `photos_on`."""
        return self._photos[index]

    def prefetch(self, index: int) -> None:
        """Decode a photo in the background."""
        self._photos.prefetch([index])

    def view(self, index: int) -> View:
        """Return the photo's camera."""
        one, image = slice(index, index + 1), self.images[index]
        size = image.camera.width, image.camera.height
        return View(self._viewmats[one], self._intrinsics[one], *size, image.pixel_size)
