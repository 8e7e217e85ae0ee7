"""Background initialisation: Gaussians in areas of photos without sparse points (ours).

docs/method.md, "A backdrop", describes the method and the reasons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...context import QUIET, Context
from ...model.scene import Float64, PosedImage, project
from ..config import Mechanism, limited

if TYPE_CHECKING:
    from ...cuda.photos import Photos
    from ..stage_data import StageData

MOST_POINTS = 20_000  # of the scene that are used: enough, because cells are large
AROUND = 8  # nearest points to a cell in the photo, which must show at least so many
BLACK = 8  # of 255: colours up to this count as black
SAMPLES = 32  # most pixels along a cell's side for its mean colour


@dataclass(frozen=True, kw_only=True)
class BackgroundPoints(Mechanism):
    """A stage that starts from the sparse points also gets Gaussians where photos show no points.

    Earns: +0.12 dB in the silhouettes, −0.02 dB on objects (marginal), +0.28 dB in images. Draft,
        six boxes of kumamon, flowerpot and the demo, two seeds (notebook/leave_one_out.md).

    Attributes:
        cells: number of cells along a photo's longer side.
    """

    name: ClassVar[str] = "background_points"

    cells: int = limited(16, least=1)

    def more_points(
        self, data: StageData, context: Context
    ) -> tuple[Float64, NDArray[np.uint8]] | None:
        return background_points(data.points, data.images, data.photos, self.cells, context)


def background_points(
    points: Float64,
    images: Sequence[PosedImage],
    photos: Photos,
    cells: int,
    context: Context = QUIET,
) -> tuple[Float64, NDArray[np.uint8]]:
    """(B, 3) positions in the world, (B, 3) uint8 colours; B is from 0 to the number of points.

    `points` are (P, 3), world units. `photos` are the pixels of `images`, in the same order; photos
    without empty cells are not decoded. `cells` is the number along the longer side of a photo.
    """
    from scipy.spatial import cKDTree

    few = points[:: max(1, -(-len(points) // MOST_POINTS))]
    found: list[Float64] = [np.zeros((0, 3))]
    colours: list[NDArray[np.uint8]] = [np.zeros((0, 3), dtype=np.uint8)]
    for index, image in enumerate(images):
        context.check_cancelled()
        shown = _projected(np.concatenate([few, *found]), image)
        rows, columns = _empty_cells(shown[0], image, cells)
        if not len(rows):
            continue
        own = _projected(points[image.point_indices], image)  # none of them is hidden
        pixels, depths = own if len(own[0]) >= AROUND else shown
        if len(pixels) < AROUND:
            continue
        colour, counts = _cell_colours(photos[index], rows, columns, cells)
        corners = np.stack((columns, rows), axis=1)[counts] * _side(image, cells)
        ends = np.minimum(corners + _side(image, cells), (image.camera.width, image.camera.height))
        centres = (corners + ends) / 2
        around = cKDTree(pixels).query(centres, k=AROUND)[1]
        found.append(_lifted(centres, depths[around].max(axis=1), image))
        colours.append(colour[counts])
    made = np.concatenate(found)[: len(points)]
    if len(made):
        text = (
            f"Training starts with {len(made):,} extra Gaussians in areas of the photos without "
            "points."
        )
        context.info(text, "detail")
    return made, np.concatenate(colours)[: len(points)]


def _side(image: PosedImage, cells: int) -> float:
    """Return the side of a cell in pixels."""
    return max(image.camera.width, image.camera.height) / cells


def _projected(points: Float64, image: PosedImage) -> tuple[Float64, Float64]:
    """(P, 3) -> pixels (S, 2) and depths (S,) of the points that lie in the photo."""
    pixels, depths, seen = project(points, image.camera, image.world_to_camera)
    return pixels[seen], depths[seen]


def _empty_cells(
    pixels: Float64, image: PosedImage, cells: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of cells without a point in them or in the eight around them."""
    from scipy.ndimage import binary_dilation

    side = _side(image, cells)
    lengths = image.camera.height, image.camera.width
    shape = tuple(min(math.ceil(length / side), cells) for length in lengths)
    near = np.zeros(shape, dtype=bool)
    columns, rows = (pixels // side).astype(np.int64).T
    near[rows, columns] = True
    empty = np.nonzero(~binary_dilation(near, np.ones((3, 3))))
    return empty[0], empty[1]


def _cell_colours(
    photo: NDArray[np.uint8], rows: NDArray[np.int64], columns: NDArray[np.int64], cells: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """(C, 3) mean colours of cells; (C,) bool: which are not black, nor ignored by a mask."""
    side = max(photo.shape[:2]) / cells
    colours = np.zeros((len(rows), 3), dtype=np.uint8)
    counts = np.zeros(len(rows), dtype=bool)
    for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
        top, left = int(row * side), int(column * side)
        cell = photo[top : int((row + 1) * side), left : int((column + 1) * side)]
        down, right = (max(1, length // SAMPLES) for length in cell.shape[:2])
        pixels = cell[::down, ::right].reshape(-1, photo.shape[2])
        if photo.shape[2] == 4:  # see `loss_masks.split_mask`
            pixels = pixels[pixels[:, 3] > 0]
        if len(pixels):
            colours[k] = pixels[:, :3].mean(axis=0).round()
            counts[k] = colours[k].max() > BLACK
    return colours, counts


def _lifted(pixels: Float64, depths: Float64, image: PosedImage) -> Float64:
    """(C, 2) pixels and (C,) depths -> (C, 3) places in the world."""
    camera, pose = image.camera, image.world_to_camera
    rays = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    seen = depths[:, None] * np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    return np.asarray((seen - pose[:3, 3]) @ pose[:3, :3])
