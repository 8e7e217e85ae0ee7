"""Divides a large scene into cells: blocks on the ground with their photos, and groups of boxes.

As in block-wise Gaussian Splatting (VastGaussian, Lin et al. 2024; CityGaussian, Liu et al. 2024;
Hierarchical 3D Gaussians, Kerbl et al. 2024), blocks are rectangles on the ground with equal
numbers of cameras and observations. A photo trains each block of which it shows enough, so blocks
share photos. Unlike there, a point that is hardly visible in its block's photos belongs to the
block whose photos show it. Boxes that many photos see together are trained together.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.gravity import rotation_between, up_direction
from ..model.roi import OrientedBox
from ..model.scene import Float64, Int64, PosedImage, SfmScene
from ..model.visibility import observed_points

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

SHOWN = 0.15  # a photo trains a cell if the cell fills at least this share of it
GRID = 24  # places across and down a photo, for finding the nearest points
FEWER = 0.5  # a point changes cells if another's photos observe it more than 1 / this as often
LEAST = 0.5  # each side of a cut has at least this part of its share of the observations
NEAR = 0.9  # share of the positions, the nearest ones, that determine the axis of a cut
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """The points that each photo observes.

    Attributes:
        scene: V photos, P points.
        seen: (V, P) sparse matrix of 1 and 0.
        areas: (V, P) sparse matrix: for each observed point, the share of the photo that is nearest
            to it. A white wall has few points, but fills the picture.
    """

    scene: SfmScene
    seen: csr_matrix
    areas: csr_matrix

    @classmethod
    def of(cls, scene: SfmScene, context: Context = QUIET) -> Views:
        """The views of a scene, by its tracks, or by projection if there are none."""
        from scipy.sparse import csr_matrix

        found = observed_points(scene, context)
        starts = np.concatenate([[0], np.cumsum([len(rows) for rows in found])])
        columns = np.concatenate([np.empty(0, np.int64), *found])
        shape = len(scene.images), len(scene.points)
        areas = []
        for image, rows in zip(scene.images, found, strict=True):
            context.check_cancelled()
            areas.append(_areas(image, scene.points[rows]))
        return cls(
            scene=scene,
            seen=csr_matrix((np.ones(len(columns)), columns, starts), shape),
            areas=csr_matrix((np.concatenate([np.empty(0), *areas]), columns, starts), shape),
        )

    def shares(self, owner: Int64, count: int) -> Float64:
        """(V, count) share of each photo that each cell fills; `owner` is (P,)."""
        from scipy.sparse import csr_matrix

        columns = np.arange(len(owner))
        cells = csr_matrix((np.ones(len(owner)), (columns, owner)), (len(owner), count))
        return np.asarray((self.areas @ cells).todense())

    def times(self, photos: Bools) -> Float64:
        """(P,) number of the selected photos (V,) that observe each point."""
        return np.asarray(self.seen.T @ photos.astype(float))


def _areas(image: PosedImage, points: Float64) -> Float64:
    """(N, 3) observed points -> (N,) share of the picture that is nearest to each."""
    from scipy.spatial import cKDTree

    if len(points) == 0:
        return np.empty(0)
    camera, local = image.camera, image.local(points)
    pixels = local[:, :2] / np.maximum(local[:, 2:], 1e-12) * (camera.fx, camera.fy)
    grid = (np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID)), axis=-1) + 0.5) / GRID
    size = np.array([camera.width, camera.height])
    places = grid.reshape(-1, 2) * size - (camera.cx, camera.cy)
    _, nearest = cKDTree(pixels).query(places)
    return np.asarray(np.bincount(nearest, minlength=len(points)) / len(places))


def ground(scene: SfmScene, positions: Float64) -> Float64:
    """(N, 3) positions -> (N, 2) on the ground, by the photos' up or the cameras' plane."""
    poses = np.array([image.world_to_camera for image in scene.images]).reshape(-1, 4, 4)
    up, _ = up_direction(poses)
    if not up.any():
        up = _axes(scene.centres())[:, 0]
    return np.asarray((positions @ rotation_between(up, np.array([0.0, 0.0, 1.0])).T)[:, :2])


def ground_cells(views: Views, count: int) -> tuple[Int64, Int64]:
    """Divide the scene into cells: the cell of each point (P,) and of each camera (V,).

    Cells are cut across their longer sides until there are `count`. Each side gets its share of the
    cameras and the observations; both have the same total weight. If cameras are so close together
    that one side would have almost no observations, only observations count.
    """
    scene = views.scene
    cameras, points = len(scene.images), len(scene.points)
    places = ground(scene, np.concatenate([scene.points, scene.centres()]))
    observations = views.times(np.ones(cameras, bool))
    weights = np.zeros((points + cameras, 2))  # columns: points, cameras
    weights[:points, 0] = observations / max(observations.sum(), 1)
    weights[points:, 1] = 1 / max(cameras, 1)
    cells = np.zeros(points + cameras, dtype=np.int64)
    _cut(places, weights, np.arange(len(places)), (0, count), cells)
    return cells[:points], cells[points:]


def _cut(
    places: Float64, weights: Float64, rows: Int64, numbers: tuple[int, int], cells: Int64
) -> None:
    """Divide rows into cells, numbered from `numbers[0]` to below `numbers[1]`."""
    first, end = numbers
    cells[rows] = first
    if end - first < 2 or len(rows) < 2:
        return
    middle = first + (end - first) // 2
    own = places[rows]
    away = np.linalg.norm(own - np.median(own, axis=0), axis=1)
    near = own[away <= np.quantile(away, NEAR)]
    along = (own - near.mean(axis=0)) @ _axes(near)[:, -1]
    along *= np.sign((along**3).sum()) or 1.0  # the same direction in every frame
    along = np.round(along / max(float(np.abs(along).max()), 1e-300), 9)  # and on every machine
    order = np.argsort(along, kind="stable")
    share = (middle - first) / (end - first)
    weight = weights[rows][order]
    both, points = np.cumsum(weight.sum(axis=1)), np.cumsum(weight[:, 0])
    at = int(np.searchsorted(both, both[-1] * share))
    shown = points[min(at, len(points) - 1)] / max(points[-1], 1e-300)
    if not LEAST * share <= shown <= 1 - LEAST * (1 - share):
        at = int(np.searchsorted(points, points[-1] * share))
    mask = np.zeros(len(rows), bool)
    mask[order[: max(1, min(at, len(rows) - 1))]] = True
    _cut(places, weights, rows[mask], (first, middle), cells)
    _cut(places, weights, rows[~mask], (middle, end), cells)


def _axes(places: Float64) -> Float64:
    """(N, D) places -> (D, D) principal axes in columns, least variance first."""
    away = places - places.mean(axis=0)
    return np.asarray(np.linalg.eigh(away.T @ away)[1])


def photos_of_cells(views: Views, owner: Int64, camera: Int64, count: int) -> Bools:
    """(V, count) which photos train which cell.

    A photo trains the cell that fills most of it, and each cell that fills `SHOWN` of it. It also
    trains its camera's cell if it shows any of it, because it shows the air there.

    `owner`: (P,) the cell of each point; `camera`: (V,) the cell of each camera.
    """
    shares = views.shares(owner, count)
    rows = np.arange(len(shares))
    chosen: Bools = shares >= SHOWN
    chosen[rows, np.where(shares.any(axis=1), shares.argmax(axis=1), camera)] = True
    chosen[rows, camera] |= shares[rows, camera] > 0
    return chosen


def visible_owners(views: Views, owner: Int64, photos: Bools) -> Int64:
    """(P,) the cell of each point, by the cells' photos.

    A point stays in its cell unless the photos of another cell observe it more than `1 / FEWER`
    times as often. Then its own cell's training hardly sees it.

    `owner`: (P,) the cell of each point by its place; `photos`: (V, count) of `photos_of_cells`.
    """
    times = np.stack([views.times(column) for column in photos.T], axis=1)
    best = times.argmax(axis=1)
    rows = np.arange(len(owner))
    hardly = times[rows, owner] < FEWER * times[rows, best]
    return np.where(hardly, best, owner).astype(np.int64)


def observed_by(views: Views, photos: Bools) -> Int64:
    """Ascending rows of the points that the selected photos (V,) observe."""
    return np.flatnonzero(views.times(photos) > 0).astype(np.int64)


def names_of(scene: SfmScene, photos: Bools) -> tuple[str, ...]:
    """The names of the selected photos (V,), in the scene's order."""
    return tuple(i.name for i, chosen in zip(scene.images, photos, strict=True) if chosen)


def rows_named(scene: SfmScene, names: Sequence[str]) -> Bools:
    """(V,) which photos have one of these names."""
    wanted = set(names)
    return np.array([image.name in wanted for image in scene.images], dtype=bool)


SHARED = 0.25  # boxes are near if this share of one box's photos also see the other box
ALL = "all"
Groups = tuple[tuple[str, ...], ...]


def parsed_groups(texts: Sequence[str], boxes: Sequence[str]) -> Groups:
    """Parse groups of boxes such as `vase,tin`; the boxes that are not named form one more group.

    `all` stands for all boxes, unless a box has that name. ConfigError: a box is unknown or named
    twice, or `all` is not alone.
    """
    if ALL in texts and ALL not in boxes and len(texts) > 1:
        raise ConfigError(f"--group {ALL} is all boxes.", "Give it alone.")
    groups = [tuple(boxes) if t == ALL and ALL not in boxes else _names(t, boxes) for t in texts]
    named = [name for group in groups for name in group]
    if not all(groups):
        raise ConfigError("--group names no box.", f"The boxes are: {', '.join(boxes)}.")
    for name in named:
        if name not in boxes:
            raise ConfigError(
                f"--group names '{name}', which is no box.", f"The boxes are: {', '.join(boxes)}."
            )
        if named.count(name) > 1:
            raise ConfigError(f"--group names box '{name}' twice.", "Name each box once.")
    rest = tuple(name for name in boxes if name not in named)
    return _ordered([*groups, rest] if rest else groups, boxes)


def _names(text: str, boxes: Sequence[str]) -> tuple[str, ...]:
    """The names in one value; a box's name may contain a comma."""
    if text in boxes:
        return (text,)
    return tuple(name.strip() for name in text.split(",") if name.strip())


def groups_by_photos(seen: Mapping[str, Set[str]]) -> Groups:
    """Group the boxes: two are in one group if they share photos, also through other boxes.

    `seen`: box -> names of the photos that see it.
    """
    boxes, group = list(seen), {name: name for name in seen}
    for index, one in enumerate(boxes):
        for other in boxes[:index]:
            if group[one] == group[other]:
                continue
            fewer = min(len(seen[one]), len(seen[other]))
            if len(seen[one] & seen[other]) >= SHARED * max(fewer, 1):
                old, new = group[one], group[other]
                group = {name: new if of == old else of for name, of in group.items()}
    found = [tuple(n for n in boxes if group[n] == of) for of in dict.fromkeys(group.values())]
    return _ordered(found, boxes)


def _ordered(groups: Iterable[Sequence[str]], boxes: Sequence[str]) -> Groups:
    """Groups and their boxes in the order of the boxes."""
    inside = [tuple(name for name in boxes if name in group) for group in groups]
    return tuple(sorted((g for g in inside if g), key=lambda group: boxes.index(group[0])))


def nearest_group(positions: Float64, groups: Sequence[Sequence[OrientedBox]]) -> Int64:
    """(N, 3) world positions -> (N,) the group with the nearest box."""
    distances = [np.min([roi.distance(positions) for roi in group], axis=0) for group in groups]
    return np.asarray(np.argmin(distances, axis=0), dtype=np.int64)
