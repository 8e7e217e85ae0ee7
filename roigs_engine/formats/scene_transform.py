"""`roigs_placement.json`: pose and scale of a model in Blender's world; numpy only.

docs/files.md describes the file. A transform applies only to a model with the recorded cameras,
because another model of the project, or a recreated one, has another frame.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from .files import read_json
from .projects import top_folder
from .transforms import numbers, similarity_flaw

Float64 = NDArray[np.float64]

FILE = "roigs_placement.json"
FAR = 1e15  # as for boxes
MOST_CAMERAS, MOST_TRANSFORMS = 32, 8
# Share of the cameras' largest distance from their mean. Refined cameras move less than this.
SAME = 0.01
HINT = "Delete it, or place the scene in Blender again."


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneTransform:
    """A model's pose and scale in the world."""

    matrix: Float64  # (4, 4) similarity from the COLMAP frame to the world in metres
    cameras: dict[str, Float64]  # photo -> (3,) centre in the COLMAP frame; at least one

    def is_of(self, cameras: Mapping[str, Float64]) -> bool:
        """Whether it is the transform of the model with these cameras, photo -> (3,) centre."""
        shared = [name for name in self.cameras if name in cameras]
        if not shared:
            return False
        known = np.array(list(self.cameras.values()))
        radius = float(np.linalg.norm(known - known.mean(axis=0), axis=1).max())
        moved = [np.linalg.norm(self.cameras[name] - cameras[name]) for name in shared]
        return float(np.median(moved)) <= SAME * radius + 1e-6 * float(np.abs(known).max())


def transform_file(colmap: Path) -> Path:
    """The file of a project; `colmap` may also be a model's folder."""
    return top_folder(Path(os.path.abspath(colmap))) / FILE


def some_cameras(cameras: Mapping[str, Float64]) -> dict[str, Float64]:
    """At most `MOST_CAMERAS` of the cameras, evenly over their sorted names."""
    names = sorted(cameras)
    return {name: cameras[name] for name in names[:: -(-len(names) // MOST_CAMERAS) or 1]}


def read_transforms(path: Path) -> list[SceneTransform]:
    """The transforms of a file, the newest first; none if there is no file.

    ConfigError: it cannot be read, or is malformed.
    """
    if not os.path.lexists(path):
        return []
    document = read_json(path, ConfigError, HINT)
    records = document.get("placements") if isinstance(document, dict) else None
    if not isinstance(records, list):
        raise ConfigError(f'{path} has no list "placements".', HINT)
    try:
        return [_transform(record) for record in records]
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path} is malformed ({error}).", HINT) from error


def transform_among(
    transforms: list[SceneTransform], cameras: Mapping[str, Float64]
) -> SceneTransform | None:
    """The transform of the model with these cameras, photo -> (3,) centre; None: it has none."""
    return next((each for each in transforms if each.is_of(cameras)), None)


def document(transform: SceneTransform, others: list[SceneTransform]) -> str:
    """The text of a file with a transform, and with those of `others` for other models."""
    kept = [other for other in others if not other.is_of(transform.cameras)]
    records = [
        {
            "matrix": entry.matrix.tolist(),
            "cameras": {name: centre.tolist() for name, centre in entry.cameras.items()},
        }
        for entry in (transform, *kept)[:MOST_TRANSFORMS]
    ]
    return json.dumps({"placements": records}, indent=1, ensure_ascii=False) + "\n"


def _transform(record: Any) -> SceneTransform:
    matrix = numbers(record["matrix"], (4, 4), "matrix", FAR)
    flaw = similarity_flaw(matrix)
    if flaw:
        raise ValueError(f"matrix is no rotation, scale and translation: {flaw}")
    centres = record["cameras"].items()
    cameras = {str(name): numbers(centre, (3,), "a camera", FAR) for name, centre in centres}
    if not cameras:
        raise ValueError("it has no cameras")
    return SceneTransform(matrix=matrix, cameras=cameras)
