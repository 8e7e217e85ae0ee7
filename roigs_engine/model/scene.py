"""The captured scene as an immutable value: pinhole cameras, posed photos, sparse points.

Frames follow docs/conventions.md: OpenCV camera axes (x right, y down, z forward), pixel centres at
+0.5, world = the COLMAP model's frame. `colmap/` builds these values from files.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

USUAL_REACH = 3.0  # cameras farther than this (see `reaches`) do not count for the extent
ONE_POSITION = 1e-5  # of the distance to the points; cameras closer together are at one position


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera; lengths in pixels.

    Attributes:
        width, height: image size.
        fx, fy: focal lengths.
        cx, cy: principal point; the centre of pixel (i, j) is at (i + 0.5, j + 0.5).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def matrix(self) -> Float64:
        """The 3x3 intrinsic matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for the photo resampled to `width` x `height`."""
        sx, sy = width / self.width, height / self.height
        scaled = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return Camera(width=width, height=height, **scaled)

    @property
    def focal(self) -> float:
        """Mean focal length, pixels: sqrt(fx * fy), the pixels per radian in the middle."""
        return math.sqrt(self.fx * self.fy)

    def thumbnail(self, side: int) -> Camera:
        """The same camera, resized so that its longer side is at most `side` pixels."""
        scale = min(1.0, side / max(self.width, self.height))
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoMask:
    """A mask of a photo: the pixels that count, or those that show an object.

    Attributes:
        digest: hash of everything that decides the mask.
        path: the mask for the photo at `PosedImage.path`, made by the engine.
        remake: recreates that file.
        small: (h, w) uint8, the mask at a small size: 255 where all pixels are in it, 0 where none.
        whole: makes the mask at the size of the file at `PosedImage.path`, turned, for resampling
            the photo's colours; None: they are resampled without it.
    """

    digest: str
    path: Path
    remake: Callable[[], object]
    small: NDArray[np.uint8]
    whole: Callable[[], NDArray[np.bool_]] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedImage:
    """One photo with its pose.

    Attributes:
        name: the photo's name in the model, unique, with `/` between folders.
        path: the undistorted photo on disk; decoding resamples it to the camera's size.
        camera: pinhole intrinsics at the resolution used for training.
        world_to_camera: (4, 4) rigid transform, COLMAP's `cam_from_world`.
        point_indices: (M,) rows of `SfmScene.points` that this photo observes, unique, ascending.
        digest: hash of everything that decides the pixels of the photo at `path`; empty: unknown.
        file_digest: hash of the photo's own file; empty: unknown.
        remake: recreates the file at `path`, if the engine made it from the photo.
        mask: which pixels count in training and evaluation; None: all.
        objects: box -> which pixels show its object, for boxes with such a mask here.
        turn: how the photo at `path` must be turned, an EXIF orientation; 1: not.
        distorted: whether the photo at `path` still has lens distortion, which `camera` does not
            describe (only in scenes loaded without pixels).
        lens: a distorted photo's camera, at the photo's own size after `turn`, as a line of
            `cameras.txt` without the id.
        whole_size: width and height of the photo before averaging; None: it is not averaged.
        exif_exposure: stops of light from EXIF (`photos.exposures`), larger is brighter; None:
            unknown.
        exposure: stops by which the photo is brighter than the scene's median; decoding removes
            this difference (`photos.exposures`).
    """

    name: str
    path: Path
    camera: Camera
    world_to_camera: Float64
    point_indices: Int64 = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    digest: str = ""
    file_digest: str = ""
    remake: Callable[[], None] | None = None
    mask: PhotoMask | None = None
    objects: Mapping[str, PhotoMask] = field(default_factory=dict)
    turn: int = 1
    distorted: bool = False
    lens: str = ""
    whole_size: tuple[int, int] | None = None
    exif_exposure: float | None = None
    exposure: float = 0.0

    @property
    def centre(self) -> Float64:
        """(3,) camera centre in the world."""
        return origin(self.world_to_camera)

    def local(self, points: Float64) -> Float64:
        """World positions (P, 3) -> (P, 3) in the camera's axes."""
        return np.asarray(points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3])

    @property
    def decoded_bytes(self) -> int:
        """Bytes of the decoded photo, with its mask."""
        channels = 3 if self.mask is None else 4
        return channels * self.camera.width * self.camera.height

    @property
    def pixel_size(self) -> float:
        """Side of a pixel, in pixels of the photo before averaging."""
        width, height = self.whole_size or (self.camera.width, self.camera.height)
        return math.sqrt(width * height / (self.camera.width * self.camera.height))

    def scaled(self, factor: float) -> PosedImage:
        """The same photo averaged to `factor` (at most 1) of its size; itself for 1."""
        if factor == 1:
            return self
        width, height = self.camera.width, self.camera.height
        size = max(1, round(width * factor)), max(1, round(height * factor))
        whole = self.whole_size or (width, height)
        return replace(self, camera=self.camera.resized(*size), whole_size=whole)

    @property
    def forward(self) -> Float64:
        """(3,) unit viewing direction in the world."""
        return self.world_to_camera[2, :3].copy()


@dataclass(frozen=True, kw_only=True, eq=False)
class SfmScene:
    """A COLMAP model: photos in name order and the sparse points they observe.

    Attributes:
        images: posed photos, sorted by name.
        points: (P, 3) world positions.
        colors: (P, 3) uint8 sRGB.
        skipped: reason -> names of the skipped photos ('missing on disk', 'without a pose').
        has_tracks: False if the model stores no 2D-3D observations.
        stray_points: number of points left out because they are far from all cameras.
    """

    images: tuple[PosedImage, ...]
    points: Float64
    colors: NDArray[np.uint8]
    skipped: dict[str, tuple[str, ...]] = field(default_factory=dict)
    has_tracks: bool = True
    stray_points: int = 0

    def select(self, names: list[str] | tuple[str, ...] | set[str]) -> SfmScene:
        """The same scene with only the named photos, in the order of this scene."""
        wanted = set(names)
        return replace(self, images=tuple(i for i in self.images if i.name in wanted))

    def without(self, names: list[str] | tuple[str, ...] | set[str]) -> SfmScene:
        """The same scene without the named photos (used to remove test photos)."""
        unwanted = set(names)
        return replace(self, images=tuple(i for i in self.images if i.name not in unwanted))

    def image(self, name: str) -> PosedImage:
        """The photo of that name; KeyError if there is none."""
        for image in self.images:
            if image.name == name:
                return image
        raise KeyError(name)

    def centres(self) -> Float64:
        """(V, 3) camera centres."""
        return np.array([image.centre for image in self.images]).reshape(-1, 3)

    def extent(self) -> float:
        """1.1 x the largest distance of a camera from the cameras' mean, world units (as in 3DGS).

        Cameras far from the others do not count. If all cameras are at one position, this would be
        0, and positions could not be trained. Then the extent is the median distance of the points
        from the cameras.
        """
        centres = self.centres()
        if len(centres) == 0:
            return 0.0
        centres = centres[reaches(centres) <= USUAL_REACH]
        middle = centres.mean(axis=0)
        extent = float(1.1 * np.linalg.norm(centres - middle, axis=1).max())
        if len(self.points) == 0:
            return extent
        away = float(np.median(np.linalg.norm(self.points - middle, axis=1)))
        return extent if extent > ONE_POSITION * away else away

    def digest(self) -> str:
        """Hash of all COLMAP data: photos' names, cameras, poses, points, tracks."""
        digest = hashlib.sha256()
        for image in self.images:
            digest.update(f"{image.name} {image.camera}".encode())
            digest.update(image.world_to_camera.tobytes() + image.point_indices.tobytes())
        digest.update(self.points.tobytes() + self.colors.tobytes())
        return digest.hexdigest()


def origin(transform: Float64) -> Float64:
    """(3,) world position of the origin of the frame that a rigid transform (4, 4) maps to."""
    return -transform[:3, :3].T @ transform[:3, 3]


def project(
    points: Float64, camera: Camera, world_to_camera: Float64
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """World positions (P, 3) -> pixels (P, 2), depths (P,), and (P,) whether the camera sees them.

    Pixels of positions behind the camera are meaningless.
    """
    local = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    depth = local[:, 2]
    safe = np.where(depth > 0, depth, 1.0)[:, None]
    pixels = local[:, :2] / safe * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    within = (pixels >= 0) & (pixels < (camera.width, camera.height))
    return pixels, depth, (depth > 0) & within.all(axis=1)


def reaches(centres: Float64) -> Float64:
    """(V, 3) camera centres -> (V,) distances from their median, relative to most of them.

    The unit is the 90 % quantile of the distances, so that no single camera decides it. If these
    cameras are all at one position, they get 0, and the others infinity.
    """
    distances = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    most = np.sort(distances)[int(0.9 * (len(distances) - 1))]
    with np.errstate(divide="ignore", invalid="ignore"):
        relative: Float64 = distances / most
    relative[distances == 0] = 0.0  # instead of NaN where `most` is 0
    return relative
