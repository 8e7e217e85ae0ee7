"""The scene that a run folder was made for."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError, EngineError
from ..exchange.axes import UP
from ..formats.files import read_json
from ..formats.run_files import BACKGROUND, COARSE, FINE, PROJECT, RESULT, SETTINGS
from ..formats.upright import levelled

if TYPE_CHECKING:
    from ..model.scene import Float64, SfmScene


def scene_of_run(folder: Path) -> SfmScene | None:
    """The scene of a run folder, if it is still there."""
    from ..colmap.project import load_colmap

    for place in _places(folder):
        with suppress(EngineError):
            return load_colmap(place, pixels=False)
    return None


def poses_of(scene: SfmScene) -> Float64:
    """(N, 4, 4) world_to_camera of its photos."""
    return np.array([image.world_to_camera for image in scene.images])


def up_in_run(path: Path) -> str | None:
    """The axis that points up, about, in a PLY that a run has made, by the photos of its scene.

    None: it is none of a run folder's, or the scene is not there.
    """
    folder = path.absolute().parent
    if folder.name in (FINE, COARSE):
        folder = folder.parent
    elif path.name not in (RESULT, BACKGROUND):
        return None
    from ..colmap.project import load_poses

    for place in _places(folder):
        with suppress(EngineError):
            return _up(load_poses(place))
    return None


def _places(folder: Path) -> list[Path]:
    """Where the scene of a run folder may be, the likelier place first."""
    places = [folder / PROJECT]
    with suppress(ConfigError, KeyError, TypeError):
        places.insert(0, Path(read_json(folder / SETTINGS, ConfigError)["scene"]))
    return places


def _up(poses: Float64) -> str | None:
    """The axis that points up, about, for photos."""
    if not len(poses):
        return None
    up = levelled(poses)[2]
    return max(UP, key=lambda axis: float(np.array(UP[axis])[:, 2] @ up))
