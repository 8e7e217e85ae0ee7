"""Mapping between the pixels of a photo's file and those of its pinhole camera.

Users' masks and strokes are in pixels of the file, with its lens distortion. They are turned if the
model's cameras are for the turned photo.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.scene import Camera, Float64, PosedImage
from ..photos.headers import photo_size
from ..photos.rotation import turned_size
from .lenses import resized_lens, undistorted_mask, undistorted_pixels, undistorted_places
from .model_files import read_model
from .photo_loader import photo_name
from .records import ModelCamera

Mask = NDArray[np.bool_]
ROWS = 256  # rows of a photo looked up at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoPixels:
    """One photo.

    Attributes:
        name: in the model.
        path, size: its file, and that file's (width, height) after `turn`.
        camera: the pinhole camera.
        lens: the distorted camera at the file's size; None: the photo has no distortion.
        turn: see `PosedImage`.
    """

    name: str
    path: Path
    size: tuple[int, int]
    camera: Camera
    lens: ModelCamera | None
    turn: int

    def pixels(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 sRGB at the camera's size; PhotoError if it cannot be decoded."""
        from PIL import Image

        from ..photos.decode import decode

        size = (self.camera.width, self.camera.height)
        if self.lens is None:
            return decode(self.path, size, self.turn)
        whole = decode(self.path, self.size, self.turn)
        flat = Image.fromarray(undistorted_pixels(whole, self.lens))
        return np.asarray(flat.resize(size, Image.Resampling.LANCZOS))

    def to_camera(self, places: Float64) -> tuple[Float64, float]:
        """(N, 2) places in the file -> places in the camera's picture; and the scale between."""
        if self.lens is None:
            factors = np.array([self.camera.width, self.camera.height]) / self.size
            return places * factors, float(factors.mean())
        found = undistorted_places(self.lens, self.camera, places)
        return found, self.camera.fx / self.lens.params[0]

    def of_file(self, mask: Mask) -> Mask:
        """Convert a mask of the file (height, width) to the camera's picture (H, W)."""
        from ..photos.mask_images import HALF, resized

        if self.lens is not None:
            mask = undistorted_mask(resized(mask, self.size), self.lens, HALF)
        return resized(mask, (self.camera.width, self.camera.height))

    def in_file(self, mask: Mask) -> Mask:
        """Convert a mask of the camera's picture (H, W) to the file; False outside its view."""
        across, down = self.size
        found = np.zeros((down, across), dtype=bool)
        x = np.arange(across) + 0.5
        for top in range(0, down, ROWS):
            y = np.arange(top, min(top + ROWS, down)) + 0.5
            places, _ = self.to_camera(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
            column, row = np.nan_to_num(np.floor(places), nan=-1).T
            inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
            values = np.zeros(len(places), dtype=bool)
            values[inside] = mask[row[inside].astype(int), column[inside].astype(int)]
            found[top : top + len(y)] = values.reshape(len(y), across)
        return found


def photo_pixels(
    model: Path, images: Iterable[PosedImage], context: Context = QUIET
) -> dict[str, PhotoPixels]:
    """Photo's name -> mapping of its pixels.

    `model`: the model's folder; `images`: of a scene that was loaded without pixels.
    """
    images = list(images)
    lenses: dict[str, ModelCamera] = {}
    if any(image.distorted for image in images):
        record = read_model(model, context)
        lenses = {photo_name(each): record.cameras[each.camera_id] for each in record.images}
    found = {}
    for image in images:
        size = turned_size(photo_size(image.path), image.turn)
        found[image.name] = PhotoPixels(
            name=image.name,
            path=image.path,
            size=size,
            camera=image.camera,
            lens=resized_lens(lenses[image.name], *size) if image.distorted else None,
            turn=image.turn,
        )
    return found
