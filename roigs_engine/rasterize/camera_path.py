"""Camera path files: the cameras of an animation.

UTF-8 JSON, with OpenCV axes, pixels and world units (docs/conventions.md):

    {"cameras": [{"name": "0001", "width": 960, "height": 540, "fx": 800.0, "fy": 800.0,
                  "cx": 480.0, "cy": 270.0, "world_to_camera": [[...4], [...4], [...4], [...4]]}]}

`world_to_camera` is a rotation and a translation. Names are unique and become file names.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError
from ..formats.files import read_json
from ..formats.names import first_taken, safe_name
from ..formats.transforms import numbers, rigid_flaw
from ..model.scene import Camera, Float64

CameraPath = Sequence[tuple[str, Camera, Float64]]

MAX_SIDE = 16384  # pixels; a larger width or height in a path file is a mistake


def load_camera_path(path: Path) -> list[tuple[str, Camera, Float64]]:
    """Load the cameras of a path file, as (name, camera, world_to_camera), in the file's order.

    ConfigError: the file is unreadable or malformed; the message names the camera.
    """
    hint = "docs/files.md describes camera path files."
    document = read_json(path, ConfigError, hint)
    records = None
    if isinstance(document, dict):  # `images` are the photos of an exported scene
        records = document.get("cameras", document.get("images"))
    if not isinstance(records, list) or not records:
        raise ConfigError(f"{path} has no list 'cameras'.", hint)
    cameras = []
    for index, record in enumerate(records):
        try:
            cameras.append(camera_from_record(record))
        except KeyError as error:
            raise ConfigError(f"{path}: camera {index} has no {error}.", hint) from error
        except (TypeError, ValueError, OverflowError) as error:
            raise ConfigError(f"{path}: camera {index} is malformed ({error}).", hint) from error
    taken = first_taken(safe_name(name) for name, _, _ in cameras)
    if taken is not None:
        raise ConfigError(f"{path}: two cameras are named '{taken}'.", "Give each its own name.")
    return cameras


def camera_from_record(record: Any) -> tuple[str, Camera, Float64]:
    """Parse an entry of a path file; KeyError, TypeError, ValueError, OverflowError if bad."""
    if not isinstance(record, dict):
        raise TypeError("not an object")
    name = record["name"]
    if not isinstance(name, str) or not name.strip():
        raise ValueError("its name must be a string")
    sides = [record["width"], record["height"]]
    if any(type(side) is not int or not 0 < side <= MAX_SIDE for side in sides):
        raise ValueError(f"width and height must be integers from 1 to {MAX_SIDE}")
    fx, fy, cx, cy = (float(record[key]) for key in ("fx", "fy", "cx", "cy"))
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0 and fy > 0):
        raise ValueError("fx and fy must be positive, cx and cy finite")
    pose = numbers(record["world_to_camera"], (4, 4), "world_to_camera")
    flaw = rigid_flaw(pose)
    if flaw:
        raise ValueError(f"world_to_camera must be a rotation and a translation, but {flaw}")
    camera = Camera(width=sides[0], height=sides[1], fx=fx, fy=fy, cx=cx, cy=cy)
    return name, camera, pose
