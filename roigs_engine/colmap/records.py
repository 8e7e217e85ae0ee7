"""Plain records of a COLMAP model, with checked numbers."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..formats.rois import FAR
from ..model.scene import Float64, Int64
from ..requests.choices import MAX_SIDE

# COLMAP's camera models: (name, number of parameters), indexed by the id in binary files.
CAMERA_MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)
LEAST_FOCAL = 1e-3
"""Least focal length, in units of the photo's longest side; damaged files may have shorter ones."""
PARAMETER_COUNT = dict(CAMERA_MODELS)

# Models whose parameters begin with one focal length; the others begin with fx and fy.
ONE_FOCAL = {
    *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "SIMPLE_RADIAL_FISHEYE", "SIMPLE_DIVISION"),
    *("SIMPLE_FISHEYE", "RADIAL", "RADIAL_FISHEYE"),
}
NO_IDS = np.empty(0, dtype=np.int64)

KNOWN_IDS = 64
"""A newer COLMAP may write ids of camera models below this; larger ones come from damaged files."""


class UnknownCameraError(ValueError):
    """A valid camera of a model that is not supported."""


Points = tuple[Int64, Float64, NDArray[np.uint8], Int64, Int64]
"""The fields of `Model` after `images`."""


@dataclass(frozen=True, kw_only=True)
class ModelCamera:
    """A camera as COLMAP stores it; `params` in the order of its model."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelImage:
    """A posed photo as COLMAP stores it.

    Attributes:
        quaternion: (4,) wxyz of the rotation world -> camera, as stored (may not be normalised).
        translation: (3,) of the same transform.
        point_ids: (M,) ids of the observed points, -1 for keypoints without one.
    """

    image_id: int
    name: str
    camera_id: int
    quaternion: Float64
    translation: Float64
    point_ids: Int64


@dataclass(frozen=True, eq=False)
class Model:
    """A COLMAP model.

    Attributes:
        point_ids, points, colors: (P,) ids, (P, 3) positions, (P, 3) uint8 sRGB.
        track_rows, track_images: (T,) rows of `points` and ids of the photos that observe them;
            empty unless the photos have no lists of observations.
    """

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    point_ids: Int64
    points: Float64
    colors: NDArray[np.uint8]
    track_rows: Int64
    track_images: Int64


def relative_names(names: Sequence[str]) -> list[str]:
    """The names of a model's photos; without their common folder if all lead out of the project.

    Some software writes absolute names (`/data/a.jpg`, `C:\\data\\a.jpg`), or `../images/a.jpg`.
    """
    paths = [name.replace("\\", "/") for name in names]
    if not all(
        path.startswith("/") or ":" in path[:2] or ".." in path.split("/") for path in paths
    ):
        return list(names)
    folders = [posixpath.normpath(path).split("/")[:-1] for path in paths]
    common = len(posixpath.commonprefix(folders))
    return ["/".join(posixpath.normpath(path).split("/")[common:]) for path in paths]


def checked_camera(model: str, width: int, height: int, params: tuple[float, ...]) -> ModelCamera:
    """The camera; ValueError if its numbers are not valid."""
    if model not in PARAMETER_COUNT:
        if model.isidentifier():
            raise UnknownCameraError(f"{model} cameras are not supported")
        raise ValueError(f"no camera model is called '{model:.40}'")
    if len(params) != PARAMETER_COUNT[model]:
        raise ValueError(f"{model} camera with {len(params)} parameters")
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
        raise ValueError(f"camera of {width} x {height} pixels")
    focals = params[: 1 if model in ONE_FOCAL else 2]
    shortest = LEAST_FOCAL * max(width, height)
    if not (np.abs(params) < FAR).all() or min(focals) < shortest:  # catches NaN too
        raise ValueError(f"{model} camera with parameters {params}")
    return ModelCamera(model=model, width=width, height=height, params=params)


def checked_image(
    image_id: int, pose: list[float], camera_id: int, name: str, point_ids: Int64
) -> ModelImage:
    """The photo; ValueError unless `pose` is a quaternion and a translation."""
    if len(pose) != 7:
        raise ValueError(f"a pose of {len(pose)} numbers")
    return ModelImage(
        image_id=image_id,
        name=name,
        camera_id=camera_id,
        quaternion=np.array(pose[:4], dtype=np.float64),
        translation=np.array(pose[4:7], dtype=np.float64),
        point_ids=point_ids,
    )


def same_shape(camera: tuple[int, int], photo: tuple[int, int]) -> bool:
    """Whether a photo (width, height) has the camera's aspect ratio, rounded by at most a pixel."""
    slack = 1 / camera[0] + 1 / camera[1]
    return abs(photo[0] / camera[0] - photo[1] / camera[1]) <= slack + 1e-9


def lens_in_words(camera: ModelCamera) -> str:
    """A camera as a line of `cameras.txt`, without its id."""
    values = camera.width, camera.height, *map(repr, camera.params)
    return " ".join(map(str, (camera.model, *values)))


def lens_from_words(words: str) -> ModelCamera:
    """The inverse of `lens_in_words`; ConfigError: the words are no camera."""
    try:
        model, width, height, *params = words.split()
        return checked_camera(model, int(width), int(height), tuple(map(float, params)))
    except ValueError as error:
        text = f"'{words}' is no camera ({error})."
        raise ConfigError(text, "Write it as in cameras.txt: MODEL WIDTH HEIGHT PARAMS.") from error
