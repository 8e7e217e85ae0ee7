"""Draws a preview of a suggested photo from the nearest photo and sparse points."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..colmap.lenses import photo_places
from ..context import QUIET, Context
from ..model.roi import EDGES, OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene, project
from ..photos.decode import load_photo
from ..photos.headers import PhotoError
from ..selection.coverage import nearest_neighbours
from .box_map import BoxMap

NEIGHBOURS = 5  # points, itself included; the distance to the farthest one is a point's size
BACKGROUND = 40
LARGEST = 0.012  # of the picture's width: half the side of a point
LINE = (255, 160, 0)
ALIKE = np.cos(np.radians(40))  # cosine of the largest angle at the box between similar photos
Pixels = NDArray[np.uint8]


class PointPictures:
    """Draws a scene's points as squares of the size of the gaps between them."""

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


def from_photos(image: Pixels, found: BoxMap, camera: Camera, world_to_camera: Float64) -> Pixels:
    """Draw the photo with the most similar view of the box over the picture (H, W, 3).

    The photo's content is assumed to be on a plane that faces the camera at the distance of the
    box's surface. So it is right near the middle. If no photo is similar, none is drawn.
    """
    centre = found.roi.centre
    photos = [photo for photo in found.images if _shows(photo, centre)]
    eye = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    ways = np.array([photo.centre for photo in photos] + [eye]) - centre
    ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
    alike = ways[:-1] @ ways[-1]
    if alike.max(initial=-1.0) < ALIKE:
        return image
    photo = photos[int(alike.argmax())]
    photo = replace(photo, camera=photo.camera.thumbnail(2 * max(camera.width, camera.height)))
    try:
        pixels = load_photo(photo)
    except PhotoError:
        return image
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    depth = _surface_depth(found, eye, world_to_camera)
    places = (rays.reshape(-1, 3) * depth - world_to_camera[:3, 3]) @ world_to_camera[:3, :3]
    at, _, shown = photo_places(photo, places)
    column, row = at[shown].astype(int).T
    result = image.copy()
    result.reshape(-1, 3)[shown] = pixels[row, column]
    return result


def _shows(photo: PosedImage, place: Float64) -> bool:
    return bool(project(place[None], photo.camera, photo.world_to_camera)[2][0])


def _surface_depth(found: BoxMap, eye: Float64, world_to_camera: Float64) -> float:
    """Median depth of the patches that face the eye; if there are none, the box's depth."""
    places = found.patches.places
    facing = ((eye - places) * found.patches.normals).sum(axis=1) > 0
    places = places[facing] if facing.any() else found.roi.centre[None]
    return float(np.median(places @ world_to_camera[2, :3] + world_to_camera[2, 3]))


def with_box(image: Pixels, roi: OrientedBox, camera: Camera, world_to_camera: Float64) -> Pixels:
    """Draw the box's edges that are in front of the camera over the picture."""
    from PIL import Image, ImageDraw

    shown = Image.fromarray(image)
    draw = ImageDraw.Draw(shown)
    pixels, depth, _ = project(roi.corners(), camera, world_to_camera)
    for a, b in EDGES:
        if depth[a] > 0 and depth[b] > 0:
            draw.line([*map(float, (*pixels[a], *pixels[b]))], fill=LINE, width=1)
    return np.asarray(shown)


def as_jpeg(image: Pixels) -> bytes:
    """Encode the picture as a JPEG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=85)
    return file.getvalue()
