"""Large photos that exist as records alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roigs_engine.model.scene import Camera, PosedImage

CAMERA = Camera(width=6000, height=4000, fx=5000.0, fy=5000.0, cx=3000.0, cy=2000.0)

ONE = 3 * 6000 * 4000

GB = 10**9


def posed(count: int, lens: Camera = CAMERA) -> list[PosedImage]:
    return [
        PosedImage(
            name=f"{k}.jpg",
            path=Path(f"{k}.jpg"),
            camera=lens,
            world_to_camera=np.eye(4),
            point_indices=np.zeros(0, np.int64),
        )
        for k in range(count)
    ]
