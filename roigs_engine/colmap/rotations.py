"""Finds the photos that the model's software turned by their EXIF tags.

COLMAP ignores the tags, other software obeys them. The size of a photo on its side shows whether it
was turned. If the size does not decide (upside down, mirrored, square), the model's other photos
decide, or else the points' colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..context import Context
from ..errors import SceneError
from ..formats.text import counted, named
from ..model.scene import Float64, Int64
from ..photos.rotation import AS_STORED, turned, turned_size
from .lenses import seen_places
from .records import NO_IDS, ModelCamera, same_shape

PHOTOS, POINTS = 4, 3000  # photos compared; points of each
SIDE = 320  # px: the photos' longer side for the comparison
FEWEST = 60  # points needed to decide
CLEARLY = 0.8  # the right turn has at most this share of the other's colour differences
VARIED = 8.0  # of 255: points' colours with less standard deviation are placeholders


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """A model's points.

    Attributes:
        points, colors: (P, 3) positions; (P, 3) uint8 sRGB.
        observed: image id -> rows of the points that it observes; all are empty if unknown.
    """

    points: Float64
    colors: NDArray[np.uint8]
    observed: Mapping[int, Int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredPhoto:
    """A photo of a model as it is stored in its file.

    Attributes:
        key, name: image id and name in the model.
        size: (width, height) of the file, not turned.
        tag: the turn by its EXIF tag (`photos.rotation`).
    """

    key: int
    name: str
    path: Path
    camera: ModelCamera
    world_to_camera: Float64
    size: tuple[int, int]
    tag: int

    @property
    def on_its_side(self) -> bool:
        """Whether it has its camera's shape either as stored or turned by 90 degrees, not both."""
        return self.fits(AS_STORED) != self.fits(6)

    def fits(self, turn: int) -> bool:
        """Whether it has its camera's shape after a turn."""
        camera = (self.camera.width, self.camera.height)
        return same_shape(camera, turned_size(self.size, turn))


def find_turns(photos: Sequence[StoredPhoto], cloud: Cloud, context: Context) -> dict[int, int]:
    """Find the turned photos: image id -> turn. Reports them, and those that are unclear."""
    tagged = [photo for photo in photos if photo.tag != AS_STORED]
    fitting = [(photo, photo.fits(AS_STORED), photo.fits(photo.tag)) for photo in tagged]
    obeyed = [photo for photo, stored, tag in fitting if tag and not stored]
    ignored = any(stored and not tag for _, stored, tag in fitting)
    unclear = [photo for photo, stored, tag in fitting if stored and tag]
    turns = {photo.key: photo.tag for photo in obeyed}
    if unclear:
        obeys: bool | None = bool(obeyed)
        if bool(obeyed) == ignored:
            obeys = _look_turned(unclear, cloud, context)
        if obeys:
            turns |= {photo.key: photo.tag for photo in unclear}
        elif obeys is None:
            context.warn(
                f"{counted(len(unclear), 'photo')} with an EXIF rotation used as stored, as COLMAP"
                f" does: {named([photo.name for photo in unclear])}. If objects look upside down or"
                " mirrored in results, apply the rotation to the photos (magick mogrify"
                " -auto-orient)."
            )
    if turns:
        names = [photo.name for photo in photos if photo.key in turns]
        context.info(
            f"{len(names)} of {counted(len(photos), 'photo')} turned by the EXIF rotation, as the"
            f" model's cameras expect: {named(names)}."
        )
    return turns


def _look_turned(unclear: Sequence[StoredPhoto], cloud: Cloud, context: Context) -> bool | None:
    """Whether the photos match the points' colours better if turned; None: it is unclear."""
    if cloud.colors.std(axis=0).max(initial=0) <= VARIED:  # the software stored no colours
        return None
    some = np.linspace(0, len(unclear) - 1, min(PHOTOS, len(unclear))).round().astype(int)
    found = []
    try:
        for number in some:
            context.check_cancelled()
            found.append(_differences(unclear[number], cloud))
    except SceneError:  # other code reports damaged photos and lenses
        return None
    stored, tagged = (np.concatenate(way) for way in zip(*found, strict=True))
    if min(len(stored), len(tagged)) < FEWEST:
        return None
    if tagged.mean() < CLEARLY * stored.mean():
        return True
    return False if stored.mean() < CLEARLY * tagged.mean() else None


def _differences(photo: StoredPhoto, cloud: Cloud) -> list[Float64]:
    """Differences of points' colours from a photo: as it is stored, and turned by its tag."""
    from ..photos.decode import decode

    scale = min(1.0, SIDE / max(photo.size))
    size = (max(1, round(photo.size[0] * scale)), max(1, round(photo.size[1] * scale)))
    pixels = decode(photo.path, size)
    rows = cloud.observed.get(photo.key, NO_IDS)
    if not any(map(len, cloud.observed.values())):  # the model has no tracks
        rows = np.arange(len(cloud.points))
    rows = np.random.default_rng(0).permutation(rows)[:POINTS]
    rotation, translation = photo.world_to_camera[:3, :3], photo.world_to_camera[:3, 3]
    local = cloud.points[rows] @ rotation.T + translation
    rows, local = rows[local[:, 2] > 0], local[local[:, 2] > 0]
    places = seen_places(photo.camera, local)
    found = []
    for picture in (pixels, turned(pixels, photo.tag)):
        height, width = picture.shape[:2]
        factors = (width / photo.camera.width, height / photo.camera.height)
        column, row = np.nan_to_num(np.floor(places * factors), nan=-1, posinf=-1, neginf=-1).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        colours = picture[row[inside].astype(int), column[inside].astype(int)].astype(np.float64)
        found.append(np.abs(colours - cloud.colors[rows[inside]]).mean(axis=1))
    return found
