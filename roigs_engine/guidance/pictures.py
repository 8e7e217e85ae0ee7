"""What a photo should show: a small picture drawn from the sparse points."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.roi import EDGES, OrientedBox
from ..model.scene import Camera, Float64, SfmScene, project
from ..selection.coverage import nearest_neighbours

NEIGHBOURS = 5  # points, itself included: a point is as large as the way to the farthest of them
BACKGROUND = 40
LARGEST = 0.012  # of the picture's width: half the side of a point
LINE = (255, 160, 0)
Pixels = NDArray[np.uint8]


class PointPictures:
    """Draws a scene's points as squares that are as large as the gaps between them."""

    def __init__(self, scene: SfmScene, context: Context = QUIET) -> None:
        use = np.isfinite(scene.points).all(axis=1)
        self._points, self._colors = scene.points[use], scene.colors[use]
        count = min(NEIGHBOURS, len(self._points))
        self._radii = np.zeros(len(self._points))
        if count > 1:
            near = self._points[nearest_neighbours(self._points, count, context)]
            self._radii = np.linalg.norm(near - self._points[:, None], axis=2).max(axis=1) / 2

    def draw(self, camera: Camera, world_to_camera: Float64) -> Pixels:
        """(H, W, 3) uint8 sRGB at the camera's size."""
        image = np.full((camera.height, camera.width, 3), BACKGROUND, np.uint8)
        pixels, depth, seen = project(self._points, camera, world_to_camera)
        rows = np.flatnonzero(seen)
        rows = rows[np.argsort(-depth[rows])]
        sizes = np.clip(
            self._radii * camera.fx / np.maximum(depth, 1e-12), 1, LARGEST * camera.width
        )
        for row in rows:
            size = int(sizes[row])
            x, y = pixels[row].astype(int)
            image[max(0, y - size) : y + size, max(0, x - size) : x + size] = self._colors[row]
        return image


def with_box(image: Pixels, roi: OrientedBox, camera: Camera, world_to_camera: Float64) -> Pixels:
    """The picture with the edges of the box that are in front of the camera."""
    from PIL import Image, ImageDraw

    shown = Image.fromarray(image)
    draw = ImageDraw.Draw(shown)
    pixels, depth, _ = project(roi.corners(), camera, world_to_camera)
    for a, b in EDGES:
        if depth[a] > 0 and depth[b] > 0:
            draw.line([*map(float, (*pixels[a], *pixels[b]))], fill=LINE, width=1)
    return np.asarray(shown)


def as_jpeg(image: Pixels) -> bytes:
    """The picture as a JPEG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=85)
    return file.getvalue()
