"""Boxes (ROI, region of interest): oriented, in the COLMAP frame; their silhouettes and files."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RoiError
from ..formats.foreground import View, foreground_bounds
from ..formats.gravity import gravity_alignment
from ..formats.rois import RoiRecord, read_rois, roi_record
from .scene import Camera, Float64, SfmScene, origin

NEAR_SHARE = 1e-3  # near plane for clipping a box, in units of the box's diagonal
# The 12 edges of a box. The bits of k are the signs of corner k (x = bit 0, y = bit 1, z = bit 2).
EDGES = tuple((a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit)
AREA_SIDE = 256  # longer side of the thumbnail for measuring a silhouette's area, pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedBox(RoiRecord):
    """A box of `rois.json` with its geometry: inside, |world_to_box . p| <= half_extents."""

    @property
    def centre(self) -> Float64:
        """(3,) centre in the world."""
        return origin(self.world_to_box)

    @property
    def diagonal(self) -> float:
        """Length of the box's space diagonal, world units."""
        return float(2 * np.linalg.norm(self.half_extents))

    def scaled(self, factor: float) -> OrientedBox:
        """The box with the same centre and sides `factor` times as long."""
        return replace(self, half_extents=self.half_extents * factor)

    def to_box(self, points: Float64) -> Float64:
        """(N, 3) world positions -> (N, 3) in units of the half extents (inside: all |x| <= 1)."""
        with np.errstate(all="ignore"):  # a Gaussian at NaN or Inf is in no box
            local = points @ self.world_to_box[:3, :3].T + self.world_to_box[:3, 3]
            scaled: Float64 = local / self.half_extents
        return scaled

    def contains(self, points: Float64) -> NDArray[np.bool_]:
        """(N, 3) world positions -> (N,) whether each lies inside or on the box."""
        within = np.abs(self.to_box(points)) <= 1
        return np.asarray(np.logical_and.reduce(within, axis=1))

    def distance(self, points: Float64) -> Float64:
        """(N, 3) world positions -> (N,) distance of each from the box, 0 inside, world units."""
        with np.errstate(all="ignore"):
            beyond = np.maximum(np.abs(self.to_box(points)) - 1, 0) * self.half_extents
            away: Float64 = np.linalg.norm(beyond, axis=1)
        return away

    def corners(self) -> Float64:
        """(8, 3) world positions of the corners; corner k has the sign bits of k."""
        bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
        local = (2 * bits - 1) * self.half_extents
        return np.asarray((local - self.world_to_box[:3, 3]) @ self.world_to_box[:3, :3])

    def silhouette_polygon(self, camera: Camera, world_to_camera: Float64) -> Float64 | None:
        """The projected box as a convex polygon, (M, 2) pixels; None if the camera does not see it.

        The box's edges are clipped at a near plane first, because the projection of corners behind
        the camera would be wrong. Do not use this for a camera inside the box (`camera_inside`):
        its silhouette is the whole image.
        """
        corners = self.corners() @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
        near = NEAR_SHARE * self.diagonal
        front = corners[:, 2] >= near
        vertices = [corners[front]]
        for a, b in () if front.all() else EDGES:
            if front[a] != front[b]:
                t = (near - corners[a, 2]) / (corners[b, 2] - corners[a, 2])
                vertices.append((corners[a] + t * (corners[b] - corners[a]))[None])
        visible = np.concatenate(vertices)
        if len(visible) < 3:
            return None
        focal, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
        pixels = visible[:, :2] / visible[:, 2:] * focal + centre
        hull = convex_hull(pixels)
        return hull if len(hull) >= 3 else None  # with fewer, the projection is a line or a point

    def camera_inside(self, world_to_camera: Float64) -> bool:
        """Whether the camera's centre lies inside the box."""
        return bool(self.contains(origin(world_to_camera)[None])[0])

    def silhouette(self, camera: Camera, world_to_camera: Float64) -> NDArray[np.bool_]:
        """(H, W) whether pixels' centres are in the projected box (the paper's mask, sec. III-B).

        All pixels if the camera is inside the box; none if the box is out of view.
        """
        shape = (camera.height, camera.width)
        if self.camera_inside(world_to_camera):
            return np.ones(shape, dtype=bool)
        polygon = self.silhouette_polygon(camera, world_to_camera)
        if polygon is None:
            return np.zeros(shape, dtype=bool)
        return fill_convex(polygon, *shape)

    def projected_area(self, camera: Camera, world_to_camera: Float64) -> float:
        """Share of the image in the silhouette, 0 to 1; measured on a thumbnail."""
        return float(self.silhouette(camera.thumbnail(AREA_SIDE), world_to_camera).mean())

    def projected_pixels(self, camera: Camera, world_to_camera: Float64) -> float:
        """Number of pixels in the silhouette, from `projected_area`."""
        return self.projected_area(camera, world_to_camera) * camera.width * camera.height


def roi_from_dict(record: Any) -> OrientedBox:
    """A box from a record of `rois.json`; RoiError if it is malformed."""
    return OrientedBox(**vars(roi_record(record)))


def load_rois(path: Path) -> list[OrientedBox]:
    """All boxes of a `rois.json`; RoiError if the file cannot be used."""
    return [OrientedBox(**vars(record)) for record in read_rois(path)]


def parse_roi(text: str) -> OrientedBox:
    """A box from the command line: `NAME=x0,y0,z0,x1,y1,z1`."""
    name, separator, numbers = text.partition("=")
    try:
        values = np.array([float(number) for number in numbers.split(",")])
        corners = values.reshape(2, 3)
    except ValueError as error:
        raise RoiError(f"Cannot read box '{text}'.", "Write NAME=x0,y0,z0,x1,y1,z1.") from error
    if not separator:
        raise RoiError(f"Box '{text}' has no name.", "Write NAME=x0,y0,z0,x1,y1,z1.")
    return roi_from_dict({"name": name, "min": corners[0], "max": corners[1]})


PIXELS_AT_ONCE = 1 << 22  # pixels of a silhouette x edges; limits the memory of intermediates


def convex_hull(points: Float64) -> Float64:
    """(N, 2) -> (M, 2) corners of the convex hull in order (Andrew's monotone chain).

    Corners that exist only due to rounding are dropped; points on a line give fewer than three.
    """
    order = sorted(map(tuple, points.tolist()))  # Python numbers are faster for few points
    slack = 1e-14 * float(np.ptp(points, axis=0).max()) ** 2

    def half(walk: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        chain: list[tuple[float, ...]] = []
        for point in walk:
            while len(chain) > 1:
                (x, y), (ax, ay), (bx, by) = chain[-2], chain[-1], point
                # Twice the triangle's area, positive for a turn to the left.
                if (ax - x) * (by - y) - (ay - y) * (bx - x) > slack:
                    break
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(order) + half(order[::-1])).reshape(-1, 2)


def fill_convex(polygon: Float64, height: int, width: int) -> NDArray[np.bool_]:
    """(H, W) whether pixels' centres are in a convex polygon (M, 2) of either orientation."""
    mask = np.zeros((height, width), dtype=bool)
    (x0, x1), (y0, y1) = (
        (math.floor(min(most, max(0, min(values)))), math.ceil(min(most, max(0, max(values)))))
        for values, most in zip(polygon.T.tolist(), (width, height), strict=True)
    )
    if x0 >= x1 or y0 >= y1:
        return mask
    following = np.concatenate([polygon[1:], polygon[:1]])
    signed_area = np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1])
    edges = (following - polygon) * np.sign(signed_area)
    # A pixel is inside if it is to the left of all edges (M, ...): down >= across.
    across = edges[:, 1:] * (np.arange(x0, x1) + 0.5 - polygon[:, :1])
    rows = max(1, PIXELS_AT_ONCE // (len(polygon) * (x1 - x0)))
    for top in range(y0, y1, rows):
        y = np.arange(top, min(top + rows, y1)) + 0.5
        down = edges[:, :1] * (y - polygon[:, 1:])
        inside = down[:, :, None] >= across[:, None, :]
        mask[top : top + len(y), x0:x1] = inside.all(axis=0)
    return mask


AUTOMATIC_NAME = "object"
"""Name of the automatic box."""


def automatic_box(scene: SfmScene) -> OrientedBox:
    """The box of `--roi auto`: around the object in most photos, with its third axis up.

    RoiError: there are too few points or photos to find it.
    """
    poses = np.array([image.world_to_camera for image in scene.images])
    transform = np.eye(4)
    transform[:3, :3] = gravity_alignment(poses)
    views = [View(pose=image.world_to_camera, **asdict(image.camera)) for image in scene.images]
    bounds = foreground_bounds(views, scene.points, transform)
    if bounds is None or not (bounds[1] > bounds[0]).all():
        raise RoiError(
            "--roi auto finds no object: too few points are in the middle of the photos.",
            "Give --rois FILE or --roi NAME=x0,y0,z0,x1,y1,z1.",
        )
    low, high = bounds
    transform[:3, 3] = -(low + high) / 2
    return OrientedBox(name=AUTOMATIC_NAME, world_to_box=transform, half_extents=(high - low) / 2)
