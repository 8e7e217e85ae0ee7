"""Active tiles: the 16x16 tiles of an image that are rendered."""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import EngineError
from .inputs import TILE


def active_tiles(
    width: int, height: int, mask: tuple[int, int, int, int] | Tensor | None
) -> tuple[tuple[int, int, int, int], Tensor | None]:
    """The active tiles: a rectangle (see `tile_rectangle`), and a mask of its tiles or None.

    `mask` is that of `rasterize`. Of one on a GPU, the rectangle is the whole image: to find a
    smaller one would wait for the GPU.

    Raises:
        EngineError: the mask does not fit the image.
    """
    if not isinstance(mask, Tensor):
        return tile_rectangle(width, height, mask), None
    if mask.dtype != torch.bool or tuple(mask.shape) != (height, width):
        raise EngineError(
            f"rasterize: mask is {mask.dtype} of shape {tuple(mask.shape)}.",
            f"Pass a bool mask of shape {(height, width)}, or x0, y0, x1, y1.",
        )
    columns, rows = -(-width // TILE), -(-height // TILE)
    padded = mask.new_zeros(rows * TILE, columns * TILE)
    padded[:height, :width] = mask
    touched = padded.reshape(rows, TILE, columns, TILE).any(dim=3).any(dim=1)
    if mask.device.type != "cpu":
        return (0, 0, columns, rows), touched
    ys, xs = touched.any(dim=1).nonzero()[:, 0], touched.any(dim=0).nonzero()[:, 0]
    if not len(ys):
        return (0, 0, 0, 0), None
    x0, y0, x1, y1 = int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1
    return (x0, y0, x1, y1), touched[y0:y1, x0:x1]


def tile_rectangle(
    width: int, height: int, mask: tuple[int, int, int, int] | None
) -> tuple[int, int, int, int]:
    """The tiles (x0, y0, x1, y1; end exclusive) that touch a rectangle of pixels; None: all."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    if mask is None:
        return 0, 0, columns, rows
    x0, y0, x1, y1 = (int(v) for v in mask)
    if x1 <= x0 or y1 <= y0:
        return 0, 0, 0, 0
    left, top = max(x0, 0) // TILE, max(y0, 0) // TILE
    right, bottom = min(-(-x1 // TILE), columns), min(-(-y1 // TILE), rows)
    if right <= left or bottom <= top:
        return 0, 0, 0, 0
    return left, top, right, bottom
