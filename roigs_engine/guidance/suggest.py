"""Chooses the next photos of a box greedily: each lowers the expected error most.

The expected error in dB is monotone and submodular. So greedy photos reach at least 1 - 1/e of the
best gain for their number (Nemhauser, Wolsey and Fisher 1978), and an earlier gain is an upper
bound of a later one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..context import QUIET, Context
from ..errors import RoiError
from ..model.scene import Camera, Float64
from ..selection.greedy import lazy_greedy
from .box_map import information, sees
from .known import KnownBox
from .places import Offset, offset_from


@dataclass(frozen=True, kw_only=True, eq=False)
class Suggestion:
    """A photo to take.

    Attributes:
        camera: its lens.
        world_to_camera: (4, 4) its pose.
        gain: expected reduction of the error by it, after those before, dB.
        value: coverage of the box with it, 0 to 1.
        distance: to the box's centre, world units.
        height: of the camera above the box's centre, world units.
        near: its offset from the nearest photo of the box.
    """

    camera: Camera
    world_to_camera: Float64
    gain: float
    value: float
    distance: float
    height: float
    near: Offset

    @property
    def centre(self) -> Float64:
        """(3,) camera centre."""
        pose = self.world_to_camera
        return np.asarray(-pose[:3, :3].T @ pose[:3, 3])


class _Greedy:
    """The map with the photos suggested so far."""

    def __init__(self, known: KnownBox, context: Context) -> None:
        self._map, self._poses = known.map, known.places.poses
        self._information = known.map.information.copy()
        self._seen = []
        for pose in self._poses:
            context.check_cancelled()
            _, density, ways = sees(self._map.patches, self._map.space, self._map.lens, pose)
            self._seen.append((density / self._map.reference, ways))
        self.decibels = [known.map.decibels(self._information)]
        self.values: list[float] = []

    def _with(self, view: int) -> Float64:
        density, ways = self._seen[view]
        more = information(self._map.patches, self._map.directions, density, ways)
        return np.asarray(self._information + more)

    def gain(self, view: int) -> float:
        """The reduction of the error by a photo, dB."""
        return self._map.decibels(self._with(view)) - self.decibels[-1]

    def add(self, view: int) -> None:
        """Add a photo."""
        self._information = total = self._with(view)
        self.decibels.append(self._map.decibels(total))
        self.values.append(float((self._map.weights * total / (1 + total)).sum()))


def suggested(known: KnownBox, count: int, context: Context = QUIET) -> list[Suggestion]:
    """Choose the next photos of a box, best first; fewer if no other place has a gain.

    RoiError: there is no place from which the box can be photographed.
    """
    found, places = known.map, known.places
    if not len(places.poses):
        raise RoiError(
            f"There is no free place around box '{found.roi.name}' for a camera.",
            "Enlarge the box if it cuts the object off, or take a few photos from farther away.",
        )
    greedy = _Greedy(known, context)
    views = list(range(len(places.poses)))
    order = lazy_greedy(views, greedy.gain, greedy.add, count, context)
    return [
        _suggestion(known, view, greedy.decibels[rank + 1] - greedy.decibels[rank], value)
        for rank, (view, value) in enumerate(zip(order, greedy.values, strict=True))
    ]


def _suggestion(known: KnownBox, view: int, gain: float, value: float) -> Suggestion:
    found, pose, up = known.map, known.places.poses[view], known.places.up
    eye = -pose[:3, :3].T @ pose[:3, 3]
    away = [float(np.linalg.norm(image.centre - eye)) for image in found.images]
    return Suggestion(
        camera=found.lens,
        world_to_camera=pose,
        gain=gain,
        value=value,
        distance=float(np.linalg.norm(eye - found.roi.centre)),
        height=float((eye - found.roi.centre) @ up),
        near=offset_from(eye, found.images[int(np.argmin(away))], up),
    )
