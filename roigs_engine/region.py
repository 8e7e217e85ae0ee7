"""The pixels of a photo that the ROI stage learns from: the boxes' silhouettes and a rim around.

What lies outside the silhouettes is the Scene-GS's business; leaving it out of most steps makes
them quicker and keeps their descent to what is wanted (ours, docs/method.md; paper: the loss is on
the entire image, sec. II-B). Regions are whole 16x16 tiles, since that is what the rasterizer works
on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .rasterize.common import TILE
from .roi import OrientedBox
from .scene import PosedImage


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """Some tiles of a photo.

    Attributes:
        mask: (H, W) bool, whole tiles.
        window: x0, y0, x1, y1 in pixels, the smallest rectangle around them.
        weights: (h, w) of the window, 1 in the mask and 0 outside, on the photos' device.
        share: of the photo's pixels that the mask holds.
    """

    mask: Tensor
    window: tuple[int, int, int, int]
    weights: Tensor
    share: float

    def crop(self, image: Tensor) -> Tensor:
        """(H, W, ...) -> its pixels in the window."""
        x0, y0, x1, y1 = self.window
        return image[y0:y1, x0:x1]


class Regions:
    """The region of each photo; found when first asked for, and kept as a small grid of tiles.

    Args: `images`, `rois`: of the stage; `device`: of the weights.
    """

    def __init__(
        self,
        images: Sequence[PosedImage],
        rois: Sequence[OrientedBox],
        device: torch.device | None = None,
    ) -> None:
        self._images, self._rois, self._device = images, rois, device
        self._tiles: dict[int, NDArray[np.bool_]] = {}

    def __getitem__(self, index: int) -> Region | None:
        """The region of photo `index`, None where no box is in sight."""
        if index not in self._tiles:
            self._tiles[index] = _tiles(self._images[index], self._rois)
        tiles = self._tiles[index]
        if not tiles.any():
            return None
        camera = self._images[index].camera
        mask = tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)[: camera.height, : camera.width]
        rows, columns = np.flatnonzero(tiles.any(axis=1)), np.flatnonzero(tiles.any(axis=0))
        x0, x1 = int(columns[0]) * TILE, min(int(columns[-1] + 1) * TILE, camera.width)
        y0, y1 = int(rows[0]) * TILE, min(int(rows[-1] + 1) * TILE, camera.height)
        weights = mask[y0:y1, x0:x1].astype(np.float32)
        return Region(
            mask=torch.from_numpy(np.ascontiguousarray(mask)),
            window=(x0, y0, x1, y1),
            weights=torch.from_numpy(weights).to(self._device),
            share=float(mask.mean()),
        )


def _tiles(image: PosedImage, rois: Sequence[OrientedBox]) -> NDArray[np.bool_]:
    """The tiles that the boxes' silhouettes touch, and those next to them.

    The rim is what the SSIM of the outermost pixels looks at, and a seam's width of surroundings.
    """
    camera = image.camera
    rows, columns = -(-camera.height // TILE), -(-camera.width // TILE)
    pixels = np.zeros((rows * TILE, columns * TILE), dtype=bool)
    for roi in rois:
        pixels[: camera.height, : camera.width] |= roi.silhouette(camera, image.world_to_camera)
    touched = pixels.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))
    padded = np.pad(touched, 1)
    grown: NDArray[np.bool_] = np.zeros_like(touched)
    for y in range(3):
        for x in range(3):
            grown |= padded[y : y + rows, x : x + columns]
    return grown
