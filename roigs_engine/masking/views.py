"""Photos cropped around a box: pixels, camera, and strokes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colmap.photo_pixels import PhotoPixels
from ..formats.scribbles import MOST, OBJECT, Stroke
from ..machine import package
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, origin

Mask = NDArray[np.bool_]
Seeds = NDArray[np.uint8]

SIDE = 640  # longest side of the working part, pixels
MARGIN = 0.15  # margin around the box's silhouette, in units of its size
MOST_WIDTH = 32767  # pixels; OpenCV draws no wider lines
SMOOTHING = 4, 20  # reach of the smoothing of fine texture: pixels, and levels of colour
FREE, ON_OBJECT, ON_BACKGROUND = 0, 1, 2
"""Values of a pixel in the seeds."""


def opencv() -> Any:
    """The module `cv2`; EngineError if it is not installed."""
    return package("cv2", "Making masks", "opencv-python-headless")


@dataclass(frozen=True, kw_only=True)
class Part:
    """The rectangle of a photo to work on, and its working size.

    Attributes:
        x, y, width, height: in pixels of the photo's camera.
        scale: pixels of the part per pixel of the photo's camera, at most 1.
    """

    x: int
    y: int
    width: int
    height: int
    scale: float

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the part in its own pixels."""
        return max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale))

    @property
    def rows(self) -> tuple[slice, slice]:
        """The part's rows and columns in the photo."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    def of_mask(self, mask: Mask) -> Mask:
        """Crop and resize a whole photo's mask to this part."""
        cv2 = opencv()
        grey = np.where(mask[self.rows], np.uint8(255), np.uint8(0))
        return np.asarray(cv2.resize(grey, self.size, interpolation=cv2.INTER_AREA) >= 128)

    def camera(self, camera: Camera) -> Camera:
        """The photo's camera, cropped to this part."""
        cx, cy = camera.cx - self.x, camera.cy - self.y
        cropped = replace(camera, width=self.width, height=self.height, cx=cx, cy=cy)
        return cropped.resized(*self.size)


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A photo cropped to a box.

    Attributes:
        part: of the photo.
        camera: of that part.
        world_to_camera: (4, 4).
        near_box: (H, W) pixels in the box's silhouette or just beside it.
        seeds: (H, W) labels from strokes: `FREE`, `ON_OBJECT` or `ON_BACKGROUND`.
        given: (H, W) the user's mask, if there is one.
        kept: (H, W) the mask, if it was made earlier and stays.
    """

    name: str
    part: Part
    camera: Camera
    world_to_camera: Float64
    photo: PhotoPixels
    near_box: Mask
    seeds: Seeds
    given: Mask | None = None
    kept: Mask | None = None

    @cached_property
    def smooth(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 sRGB of the part without fine texture; PhotoError if it is damaged."""
        cv2 = opencv()
        pixels = self.photo.pixels()[self.part.rows]
        pixels = cv2.resize(pixels, self.part.size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.pyrMeanShiftFiltering(pixels, *SMOOTHING))

    @property
    def known(self) -> Mask | None:
        """The existing mask; None: it must be made."""
        return self.kept if self.given is None else self.given

    @property
    def centre(self) -> Float64:
        """(3,) camera centre in the world."""
        return origin(self.world_to_camera)

    @property
    def is_scribbled(self) -> bool:
        """Whether there are strokes on it."""
        return bool(self.seeds.any())

    @property
    def shows_object(self) -> bool:
        """Whether a stroke or the user's mask marks the object here."""
        return bool((self.seeds == ON_OBJECT).any()) or bool(
            self.given is not None and self.given.any()
        )


def part_around(roi: OrientedBox, camera: Camera, world_to_camera: Float64) -> Part | None:
    """The part of a photo around a box; None if the photo does not show it."""
    low, high = np.zeros(2), np.array([camera.width, camera.height], dtype=float)
    if not roi.camera_inside(world_to_camera):
        polygon = roi.silhouette_polygon(camera, world_to_camera)
        if polygon is None:
            return None
        margin = MARGIN * np.ptp(polygon, axis=0).max() + 2
        around = polygon.min(axis=0) - margin, polygon.max(axis=0) + margin
        low, high = np.clip(around, low, high)
    x0, y0 = (math.floor(value) for value in low)
    x1, y1 = (math.ceil(value) for value in high)
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    scale = min(1.0, SIDE / max(x1 - x0, y1 - y0))
    return Part(x=x0, y=y0, width=x1 - x0, height=y1 - y0, scale=scale)


def view_of(
    photo: PhotoPixels,
    roi: OrientedBox,
    part: Part,
    world_to_camera: Float64,
    strokes: tuple[Stroke, ...] = (),
    given: Mask | None = None,
) -> View:
    """Make the view of a part of a photo.

    Args:
        roi: the box, in the frame of `world_to_camera`, (4, 4).
        part: of the photo, from `part_around`.
        strokes: on the photo, in pixels of its file.
        given: (H, W) the user's mask at the size of the photo's camera.
    """
    camera = part.camera(photo.camera)
    near = roi.scaled(1.0 + MARGIN / 3).silhouette(camera, world_to_camera)
    return View(
        name=photo.name,
        part=part,
        camera=camera,
        world_to_camera=world_to_camera,
        photo=photo,
        near_box=near,
        seeds=draw_strokes(photo, part, strokes),
        given=None if given is None else part.of_mask(given),
    )


def draw_strokes(photo: PhotoPixels, part: Part, strokes: tuple[Stroke, ...]) -> Seeds:
    """Draw strokes as seeds (H, W) in a part of a photo; later strokes cover earlier ones."""
    cv2 = opencv()
    across, down = part.size
    seeds = np.zeros((down, across), dtype=np.uint8)
    for stroke in strokes:
        places, unit = photo.to_camera(stroke.points)
        local = (places - (part.x, part.y)) * part.scale - 0.5  # OpenCV has centres at integers
        shift = 4
        lines = [
            np.round(line * (1 << shift)).astype(np.int32) for line in _pieces(local) if len(line)
        ]
        width = min(MOST_WIDTH, max(1, round(stroke.width * unit * part.scale)))
        value = ON_OBJECT if stroke.kind == OBJECT else ON_BACKGROUND
        if lines:
            cv2.polylines(seeds, lines, False, value, width, cv2.LINE_8, shift)
    return seeds


def _pieces(places: Float64) -> list[Float64]:
    """Split a line (N, 2) at places that the lens cannot show."""
    with np.errstate(invalid="ignore"):
        lost = np.flatnonzero(~(np.abs(places) < MOST).all(axis=1))
    pieces = np.split(places, np.unique([*lost, *(lost + 1)]).astype(int))
    shown = [piece for piece in pieces if (np.abs(piece) < MOST).all()]
    return [np.repeat(piece, 2, axis=0) if len(piece) == 1 else piece for piece in shown]


def in_photo(mask: Mask, part: Part, camera: Camera) -> Mask:
    """Convert a part's mask to a mask of the whole photo, at its camera's size."""
    cv2 = opencv()
    whole = np.zeros((camera.height, camera.width), dtype=bool)
    grey = np.where(mask, np.uint8(255), np.uint8(0))
    grown = cv2.resize(grey, (part.width, part.height), interpolation=cv2.INTER_LINEAR)
    whole[part.rows] = grown >= 128
    return whole
