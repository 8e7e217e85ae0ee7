"""Which photos a model's software has turned by their EXIF tags.

COLMAP ignores the tags, other software obeys them. A photo on its side tells by its size which it
was. Where the size cannot tell (upside down, mirrored, square), the model's other photos do, and
else the colours: with photos turned rightly, a point has the same colour in all of them.
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
from .records import NO_IDS, ModelCamera, same_shape
from .undistort import seen_places

ANCHORS, PARTNERS = 4, 2  # photos that are compared; with others, each
POINTS = 3000
SIDE = 320  # px: the photos' longer side for that
FEWEST = 60  # places that decide
CLEARLY = 0.8  # the right way has at most this share of the other's differences
VARIED = 8.0  # least standard deviation of points' colours that mean something, of 255


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """A model's points.

    Attributes:
        points, colors: (P, 3) positions; (P, 3) uint8 sRGB.
        observed: image id -> rows of the points that it observes; all empty: not known.
    """

    points: Float64
    colors: NDArray[np.uint8]
    observed: Mapping[int, Int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredPhoto:
    """A photo of a model as its file has it.

    Attributes:
        key, name: image id and name in the model.
        size: (width, height) of the file, not turned.
        tag: its turn by EXIF (`photos.rotation`).
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
        """Whether it would have its camera's shape on its other side."""
        return self.fits(AS_STORED) != self.fits(6)

    def fits(self, turn: int) -> bool:
        """Whether it has its camera's shape after a turn."""
        camera = (self.camera.width, self.camera.height)
        return same_shape(camera, turned_size(self.size, turn))


def find_turns(photos: Sequence[StoredPhoto], cloud: Cloud, context: Context) -> dict[int, int]:
    """Image id -> turn, of the photos that are turned; says which, and which may have to be."""
    tagged = [photo for photo in photos if photo.tag != AS_STORED]
    fitting = [(photo, photo.fits(AS_STORED), photo.fits(photo.tag)) for photo in tagged]
    obeyed = [photo for photo, stored, tag in fitting if tag and not stored]
    ignored = any(stored and not tag for _, stored, tag in fitting)
    unclear = [photo for photo, stored, tag in fitting if stored and tag]
    turns = {photo.key: photo.tag for photo in obeyed}
    if unclear:
        obeys: bool | None = bool(obeyed)
        if bool(obeyed) == ignored:
            obeys = _look_turned(unclear, photos, turns, cloud, context)
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


def _look_turned(
    unclear: Sequence[StoredPhoto],
    photos: Sequence[StoredPhoto],
    turns: Mapping[int, int],
    cloud: Cloud,
    context: Context,
) -> bool | None:
    """Whether the photos fit the points' colours better if turned; None: that is not clear."""
    chosen, rows = _compared(unclear, photos, cloud, context)
    keys = {photo.key for photo in unclear}
    samples: dict[bool, list[Float64]] = {False: [], True: []}
    try:
        for photo in chosen:
            context.check_cancelled()
            usual = turns.get(photo.key, AS_STORED)
            ways = (AS_STORED, photo.tag) if photo.key in keys else (usual, usual)
            pictures = _sampled(photo, ways, rows, cloud)
            for way, colours in zip((False, True), pictures, strict=True):
                samples[way].append(colours)
    except SceneError:  # damaged photos and lenses are reported where they are used
        return None
    open_ = np.array([photo.key in keys for photo in chosen])
    stored, tagged = (_difference(samples[way], open_, cloud.colors[rows]) for way in (False, True))
    if tagged < CLEARLY * stored:
        return True
    return False if stored < CLEARLY * tagged else None  # NaN: neither


def _compared(
    unclear: Sequence[StoredPhoto], photos: Sequence[StoredPhoto], cloud: Cloud, context: Context
) -> tuple[list[StoredPhoto], Int64]:
    """Some unclear photos with those that share most points with them; and rows of points."""
    places = np.linspace(0, len(unclear) - 1, min(ANCHORS, len(unclear))).round().astype(int)
    anchors = [unclear[k] for k in places]
    chosen = {photo.key: photo for photo in anchors}
    fits = [photo for photo in photos if photo.fits(AS_STORED) or photo.fits(photo.tag)]
    rng, some = np.random.default_rng(0), []
    for anchor in anchors:
        rows = cloud.observed.get(anchor.key, NO_IDS)
        some.append(rng.permutation(rows)[: POINTS // len(anchors)])
        shared = []
        for photo in fits:
            context.check_cancelled()
            shared.append(len(np.intersect1d(some[-1], cloud.observed.get(photo.key, NO_IDS))))
        others = [k for k in np.argsort(shared, kind="stable")[::-1] if fits[k] is not anchor]
        chosen |= {fits[k].key: fits[k] for k in others[:PARTNERS]}
    found = np.unique(np.concatenate(some))
    if not len(found):  # the model has no tracks
        found = np.sort(rng.permutation(len(cloud.points))[:POINTS])
    return list(chosen.values()), found


def _sampled(photo: StoredPhoto, ways: Sequence[int], rows: Int64, cloud: Cloud) -> list[Float64]:
    """(N, 3) colours of the points at `rows`, if turned in each of the ways; NaN: not seen."""
    from ..photos.decode import decode

    scale = min(1.0, SIDE / max(photo.size))
    size = (max(1, round(photo.size[0] * scale)), max(1, round(photo.size[1] * scale)))
    pixels = decode(photo.path, size)
    seen = np.isin(rows, cloud.observed.get(photo.key, NO_IDS))
    if not any(map(len, cloud.observed.values())):
        seen[:] = True
    rotation, translation = photo.world_to_camera[:3, :3], photo.world_to_camera[:3, 3]
    local = cloud.points[rows] @ rotation.T + translation
    ahead = seen & (local[:, 2] > 0)
    places = np.full((len(rows), 2), -1.0)
    places[ahead] = seen_places(photo.camera, local[ahead])
    found = []
    for turn in ways:
        picture = turned(pixels, turn)
        height, width = picture.shape[:2]
        factors = (width / photo.camera.width, height / photo.camera.height)
        column, row = np.nan_to_num(np.floor(places * factors), nan=-1, posinf=-1, neginf=-1).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        colours = np.full((len(rows), 3), np.nan)
        colours[inside] = picture[row[inside].astype(int), column[inside].astype(int)]
        found.append(colours)
    return found


def _difference(
    samples: Sequence[Float64], unclear: NDArray[np.bool_], colors: NDArray[np.uint8]
) -> float:
    """How much the unclear photos' colours differ from those elsewhere; NaN: too few places."""
    columns = np.array(samples)  # (photos, points, 3)
    if colors.std(axis=0).max(initial=0) > VARIED:  # else the software has stored none
        columns = np.concatenate([columns, colors[None].astype(np.float64)])
    count = np.isfinite(columns[..., 0]).sum(axis=0)
    total = np.nansum(columns, axis=0)
    own = columns[: len(samples)][unclear]
    with np.errstate(invalid="ignore", divide="ignore"):
        others = (total - own) / (count - 1)[:, None]
    difference = np.abs(own - others).mean(axis=2)
    difference = difference[np.isfinite(difference)]
    return float(difference.mean()) if len(difference) >= FEWEST else float("nan")
