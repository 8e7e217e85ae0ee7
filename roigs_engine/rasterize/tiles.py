"""Active tiles: the 16x16 tiles of an image that are rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..errors import EngineError
from .inputs import TILE


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveTiles:
    """The tiles of an image that are rendered.

    With a `window` (x0, y0, x1, y1 in pixels, end exclusive), images contain only this part of the
    picture, and the rest takes no memory or time. A window consists of whole tiles, and contains
    all active ones.
    """

    size: tuple[int, int]  # width and height of the image, pixels
    rectangle: tuple[int, int, int, int]  # of tiles around the active ones, see `tile_rectangle`
    mask: Tensor | None = None  # (rows, columns) bool, active tiles of the rectangle; None for all
    window: tuple[int, int, int, int] | None = None

    @property
    def shown(self) -> tuple[int, int, int, int]:
        """Return the window, or the whole image."""
        return (0, 0, *self.size) if self.window is None else self.window

    def windowed(self) -> ActiveTiles:
        """Return the same tiles with their rectangle as the window."""
        return replace(self, window=pixel_rectangle(self.size, self.rectangle))


Mask = tuple[int, int, int, int] | Tensor | ActiveTiles | None
"""Mask of `rasterize`: a rectangle of pixels, (H, W) bool, tiles, or None for everything."""


def active_tiles(width: int, height: int, mask: Mask) -> ActiveTiles:
    """Return the tiles of an image that a mask touches; EngineError if it does not fit the image.

    For a mask on a GPU, the rectangle is the whole image: finding a smaller one would wait for the
    GPU.
    """
    size = (width, height)
    if isinstance(mask, ActiveTiles):
        _check(mask, size)
        return mask
    if not isinstance(mask, Tensor):
        return ActiveTiles(size=size, rectangle=tile_rectangle(width, height, mask))
    if mask.dtype != torch.bool or tuple(mask.shape) != (height, width):
        raise EngineError(
            f"rasterize: mask is {mask.dtype} of shape {tuple(mask.shape)}.",
            f"Pass a bool mask of shape {(height, width)}, or x0, y0, x1, y1.",
        )
    touched = touched_tiles(mask)
    if mask.device.type != "cpu":
        rows, columns = touched.shape
        return ActiveTiles(size=size, rectangle=(0, 0, columns, rows), mask=touched)
    return tiles_of_grid(touched, size)


def touched_tiles(mask: Tensor) -> Tensor:
    """(rows, columns) bool: tiles with a pixel of a mask (H, W) that begins at a tile's corner."""
    (height, width), device = mask.shape, mask.device
    rows, columns = -(-height // TILE), -(-width // TILE)
    padded = torch.zeros(rows * TILE, columns * TILE, dtype=torch.bool, device=device)
    padded[:height, :width] = mask
    return padded.reshape(rows, TILE, columns, TILE).any(dim=3).any(dim=1)


def _check(tiles: ActiveTiles, size: tuple[int, int]) -> None:
    """Raise EngineError unless these are tiles of an image of this size; kernels rely on it."""
    hint = "Make them with active_tiles, for this image."
    if tiles.size != size:
        raise EngineError(f"rasterize: tiles of an image of {tiles.size}, not {size} pixels.", hint)
    (left, top, right, bottom), mask = tiles.rectangle, tiles.mask
    _, _, columns, rows = tile_rectangle(*size, None)
    shape = (bottom - top, right - left)
    fits = 0 <= left <= right <= columns and 0 <= top <= bottom <= rows
    if not fits or (mask is not None and (mask.dtype, tuple(mask.shape)) != (torch.bool, shape)):
        raise EngineError("rasterize: the tiles' rectangle and mask do not fit the image.", hint)
    if tiles.window is None:
        return
    x0, y0, x1, y1 = inside = tile_rectangle(*size, tiles.window)
    if tiles.window != pixel_rectangle(size, inside) or x0 == x1:
        raise EngineError(f"rasterize: the window {tiles.window} is not made of whole tiles.")
    if left < right and not (x0 <= left and y0 <= top and right <= x1 and bottom <= y1):
        raise EngineError(f"rasterize: active tiles lie beyond the window {tiles.window}.")


def tiles_of_grid(grid: Tensor, size: tuple[int, int]) -> ActiveTiles:
    """Return the tiles set in a (rows, columns) bool grid of an image's tiles, on the CPU."""
    ys, xs = grid.any(dim=1).nonzero()[:, 0], grid.any(dim=0).nonzero()[:, 0]
    if not len(ys):
        return ActiveTiles(size=size, rectangle=(0, 0, 0, 0))
    x0, y0, x1, y1 = int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1
    return ActiveTiles(size=size, rectangle=(x0, y0, x1, y1), mask=grid[y0:y1, x0:x1])


def pixel_rectangle(
    size: tuple[int, int], tiles: tuple[int, int, int, int]
) -> tuple[int, int, int, int]:
    """Return a rectangle of tiles in pixels of the image: x0, y0, x1, y1, with an exclusive end."""
    (width, height), (left, top, right, bottom) = size, tiles
    return left * TILE, top * TILE, min(right * TILE, width), min(bottom * TILE, height)


def tile_rectangle(
    width: int, height: int, mask: tuple[int, int, int, int] | None
) -> tuple[int, int, int, int]:
    """Return the tiles (x0, y0, x1, y1; end exclusive) that touch a rectangle of pixels, or all."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    if mask is None:
        return 0, 0, columns, rows
    x0, y0, x1, y1 = (int(v) for v in mask)
    left, top = max(x0, 0) // TILE, max(y0, 0) // TILE
    right, bottom = min(-(-x1 // TILE), columns), min(-(-y1 // TILE), rows)
    if min(x1 - x0, y1 - y0, right - left, bottom - top) <= 0:
        return 0, 0, 0, 0
    return left, top, right, bottom
