"""The record of a photo on its camera object, with COLMAP's exact values. No bpy.

Blender stores matrices as 32-bit floats, and a lens and a shift instead of pixels. The record keeps
the original numbers, so that the engine gets them back exactly.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..shared import text as texts
from .frames import Intrinsics, Matrix

MOST = 1 << 20
"""Largest valid side in pixels, larger than that of any photo."""
FAR = 1e15
"""Largest valid number in a pose, as for boxes and placements."""


def _is_pose(matrix: Matrix) -> bool:
    """Whether a matrix is roughly a rotation, with a translation; False for NaN."""
    if matrix.shape != (4, 4) or not (np.abs(matrix) < FAR).all():
        return False
    turns = (np.abs(matrix[:3, :3]) < 2).all() and np.linalg.det(matrix[:3, :3]) > 0.5
    return bool(turns and (matrix[3] == (0, 0, 0, 1)).all())


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A posed photo.

    Attributes:
        name: as in the COLMAP model; with `/` if it is in a subfolder.
        path: of the file; empty if it is missing.
        intrinsics: in pixels.
        world_to_camera: rows of the pose in the COLMAP frame, OpenCV axes.
        lens: the camera of a photo with distortion, in the format of `cameras.txt` and at the
            size of the file; else empty.
        turn: EXIF orientation by which training turns the photo; 1 for none.
        as_stored: whether training uses the file's pixels unchanged.
    """

    name: str
    path: str
    intrinsics: Intrinsics
    world_to_camera: tuple[tuple[float, ...], ...]
    lens: str = ""
    turn: int = 1
    as_stored: bool = True

    @property
    def pose(self) -> Matrix:
        """`world_to_camera` as a matrix."""
        return np.array(self.world_to_camera)

    @property
    def lens_size(self) -> tuple[int, int] | None:
        """Return width and height of a stored photo with distortion, after `turn`; else None."""
        try:
            width, height = map(int, self.lens.split()[1:3])
        except ValueError:  # no lens, or an invalid one
            return None
        return (width, height) if min(width, height) > 0 else None

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Photo:
        """Parse an image of the engine's `scene.json`, or a record from `to_json`.

        ValueError, KeyError, TypeError or OverflowError: the record is invalid.
        """
        found = cls(
            name=str(record["name"]),
            path=str(record.get("path") or ""),
            intrinsics=Intrinsics(
                width=int(record["width"]),
                height=int(record["height"]),
                fx=float(record["fx"]),
                fy=float(record["fy"]),
                cx=float(record["cx"]),
                cy=float(record["cy"]),
            ),
            world_to_camera=tuple(
                tuple(float(v) for v in row) for row in record["world_to_camera"]
            ),
            lens=str(record.get("lens", "")),
            turn=int(record.get("turn", 1)),
            as_stored=bool(record.get("as_stored", True)),
        )
        if not _is_pose(found.pose):
            raise ValueError("a pose of numbers is missing")
        found.name.encode()  # raises for names that Blender does not accept
        known = found.intrinsics
        if not np.isfinite((known.fx, known.fy, known.cx, known.cy)).all():
            raise ValueError("numbers of the camera are missing")
        sides = known.width, known.height
        if min(sides) < 1 or max(sides) > MOST or min(known.fx, known.fy) <= 0:
            raise ValueError("the camera has no size")
        return found

    def to_json(self) -> str:
        """Return one line of text that `from_json` reads back exactly."""
        record = asdict(self)
        record |= record.pop("intrinsics")
        return json.dumps(record, ensure_ascii=False)

    @classmethod
    @lru_cache(maxsize=1 << 14)  # panels and views read all photos repeatedly
    def from_json(cls, text: str) -> Photo | None:
        """Parse a record; None if it is not valid."""
        try:
            return cls.from_dict(texts.parse_json(text.encode()))
        except (ValueError, KeyError, TypeError, OverflowError):
            return None
