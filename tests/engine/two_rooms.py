"""A scene of two rooms that few photos show both of, and an object in each, for tests of cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from tests.engine.synthetic_scene import make_scene

APART = 12.0  # of the rooms' middles, along x; each shell has a radius of 2.5
BOXES = tuple(
    OrientedBox.between(name, [x - 0.6, -0.6, -0.6], [x + 0.6, 0.6, 0.6])
    for name, x in (("east", 0.0), ("west", APART))
)


def two_rooms(folder: Path, views: int = 12) -> SfmScene:
    """Twice the scene of `make_scene`, the second `APART` away; as many photos in each."""
    room = make_scene(folder, views)
    count = len(room.points)
    others = []
    for image in room.images:
        pose = image.world_to_camera.copy()
        pose[:3, 3] -= pose[:3, 0] * APART
        others.append(
            replace(
                image,
                name=f"w{image.name}",
                world_to_camera=pose,
                point_indices=image.point_indices + count,
            )
        )
    return replace(
        room,
        images=(*room.images, *others),
        points=np.concatenate([room.points, room.points + np.array([APART, 0, 0])]),
        colors=np.concatenate([room.colors, room.colors]),
    )
