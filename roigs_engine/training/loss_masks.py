"""Loss masks: a step's training pixels, the boxes' silhouettes and a margin.

If a photo has a mask of a box's object, the mask is used instead of the box's silhouette. Masks are
whole 16x16 tiles, the rasterizer's unit of work (ours, docs/method.md, "Masks"; the paper's loss is
on the entire image, sec. II-B). No stage trains pixels that the photo's own mask ignores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU, sent
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..photos.mask_images import load_object_mask
from ..rasterize.inputs import TILE
from ..rasterize.tiles import ActiveTiles, tiles_of_grid, touched_tiles

MOST_WEIGHT = 2.0  # relative to the mean mask's: a tiny mask must not dominate a box


@dataclass(frozen=True, kw_only=True, eq=False)
class LossMask:
    """The mask of one photo; it takes little memory.

    Attributes:
        tiles: of the mask, on the training device. Their window is the mask's bounding box.
        loss_weight: weight of the mask's mean loss; a whole photo has 1.
    """

    tiles: ActiveTiles
    loss_weight: float

    @property
    def weights(self) -> Tensor:
        """(h, w) weights in the window, 1 in the mask and 0 outside, on the training device."""
        grid = self._grid.to(torch.float32)
        (rows, columns), (x0, y0, x1, y1) = grid.shape, self.tiles.shown
        whole = grid[:, None, :, None].expand(rows, TILE, columns, TILE)
        return whole.reshape(rows * TILE, columns * TILE)[: y1 - y0, : x1 - x0]

    def crop(self, image: Tensor) -> Tensor:
        """(H, W, ...) -> (h, w, ...): the image's pixels in the window."""
        x0, y0, x1, y1 = self.tiles.shown
        return image[y0:y1, x0:x1]

    def counting(self, counted: Tensor) -> ActiveTiles:
        """Return the tiles with pixels in `counted`, (H, W) bool; the window stays."""
        return replace(self.tiles, mask=self._grid & touched_tiles(self.crop(counted)))

    @property
    def _grid(self) -> Tensor:
        """(rows, columns) bool, the tiles in the window."""
        assert self.tiles.mask is not None
        return self.tiles.mask


class LossMasks:
    """The mask of each photo, computed on first use and cached.

    Args:
        images, rois: of the stage.
        drawn: row numbers of the photos that the stage's steps draw.
        device: for training.
        view_weighting: exponent w of the per-view weighting. A mask with the share s of its photo
            has the loss weight s (m / s)^w, where m is the geometric mean share. With 0, a pixel
            weighs as much as in a whole photo. With 1, all masks weigh the same. Above 1, smaller
            masks weigh more, up to `MOST_WEIGHT` times as much.
        context: checked for cancellation.
    """

    def __init__(
        self,
        images: Sequence[PosedImage],
        rois: Sequence[OrientedBox],
        drawn: Sequence[int],
        device: torch.device = CPU,
        view_weighting: float = 0.0,
        context: Context = QUIET,
    ) -> None:
        self._images, self._rois, self._device = images, rois, device
        self._weighting, self._context = view_weighting, context
        self._tiles: dict[int, NDArray[np.bool_]] = {}
        self._masks: dict[int, LossMask | None] = {}
        self._mean_share = 0.0  # the geometric mean
        if view_weighting:
            shares = self.shares(drawn)
            if (shown := shares[shares > 0]).size:
                self._mean_share = float(np.exp(np.log(shown).mean()))

    def __getitem__(self, index: int) -> LossMask | None:
        """Return the mask of photo `index`; None if it sees no box."""
        if index in self._masks:
            return self._masks[index]
        grid, camera = self._tiles_of(index), self._images[index].camera
        if not grid.any():
            return self._masks.setdefault(index, None)
        tiles = tiles_of_grid(torch.from_numpy(grid), (camera.width, camera.height))
        assert tiles.mask is not None
        made = LossMask(
            tiles=replace(tiles, mask=sent(tiles.mask.contiguous(), self._device)).windowed(),
            loss_weight=self._loss_weight(float(self._mask(index).mean())),
        )
        return self._masks.setdefault(index, made)

    def shares(self, rows: Sequence[int]) -> NDArray[np.float64]:
        """Return the share of the pixels of each of these photos that its mask has."""
        found = []
        for row in rows:
            self._context.check_cancelled()
            found.append(self._mask(row).mean())
        return np.array(found)

    def _loss_weight(self, share: float) -> float:
        if not self._weighting:
            return share
        ratio = self._mean_share / share
        if self._weighting <= 1:
            return float(share * ratio**self._weighting)
        return float(self._mean_share * min(ratio ** (self._weighting - 1), MOST_WEIGHT))

    def _mask(self, index: int) -> NDArray[np.bool_]:
        tiles, camera = self._tiles_of(index), self._images[index].camera
        return tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)[: camera.height, : camera.width]

    def _tiles_of(self, index: int) -> NDArray[np.bool_]:
        if index not in self._tiles:
            self._tiles[index] = _tiles(self._images[index], self._rois)
        return self._tiles[index]


def _tiles(image: PosedImage, rois: Sequence[OrientedBox]) -> NDArray[np.bool_]:
    """(rows, columns): the tiles that the boxes touch in the photo, and the tiles next to them.

    The margin covers the SSIM window of the outermost pixels, and some background, which keeps the
    transition smooth.
    """
    camera = image.camera
    pixels = np.zeros((camera.height, camera.width), dtype=bool)
    for roi in rois:
        pixels |= shown_pixels(roi, image)
    touched = touched_tiles(torch.from_numpy(pixels)).numpy()
    return np.asarray(binary_dilation(touched, np.ones((3, 3))))


def shown_pixels(roi: OrientedBox, image: PosedImage) -> NDArray[np.bool_]:
    """(H, W) the pixels of the box's silhouette; only its object's if the photo has its mask."""
    silhouette = roi.silhouette(image.camera, image.world_to_camera)
    mask = load_object_mask(image, roi.name)
    return silhouette if mask is None else silhouette & mask


def split_mask(photo: Tensor) -> tuple[Tensor, Tensor | None]:
    """Split a photo from `load_masked` into its colours, and the pixels that count."""
    if photo.shape[-1] == 3:
        return photo, None
    return photo[..., :3], photo[..., 3] > 0


def counted_weights(weights: Tensor | None, counted: Tensor) -> tuple[Tensor, Tensor]:
    """Return the weights of the pixels that count, and their share of all weights, a scalar.

    Multiplied by this share, the loss weighs a pixel as in a photo without a mask.
    """
    if weights is None:
        kept = counted.to(torch.float32)
        return kept, kept.mean()
    kept = weights * counted
    return kept, kept.sum() / weights.sum()
