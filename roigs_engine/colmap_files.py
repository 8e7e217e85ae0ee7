"""Reading COLMAP's model files, binary and text, into plain arrays; every count is distrusted.

The readers do not rely on COLMAP's own: that one loops for ever or asks for absurd amounts of
memory on damaged files and rejects a model with a single dangling observation. `rigs` and `frames`
files are not needed, as `images` holds each photo's full pose, rig or not.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import SceneError
from .events import Check, go_on
from .scene import FAR, Float64, Int64

T = TypeVar("T")

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
PARAMETER_COUNT = dict(CAMERA_MODELS)
# Models whose parameters begin with one focal length; of the others' two, fx and fy.
ONE_FOCAL = {
    *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "SIMPLE_RADIAL_FISHEYE", "SIMPLE_DIVISION"),
    *("SIMPLE_FISHEYE", "RADIAL", "RADIAL_FISHEYE"),
}
MAX_SIDE = 1 << 20  # pixels; a larger camera is a damaged file
NO_IDS = np.empty(0, dtype=np.int64)
HINT_DAMAGED = "The file is damaged or unfinished: export the model again."
# One point of points3D.bin up to its track; after it come (image id, index) pairs of uint32.
POINT_HEAD = np.dtype(
    [("id", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")]
)
ROWS_AT_ONCE = 1 << 14  # rows whose bytes are gathered at a time: the index takes 8 bytes for each
SMALLEST_IMAGE = 73  # bytes of one photo of images.bin, its name of no letter and unseeing
OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])


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
        quaternion: (4,) wxyz of the rotation world -> camera, as stored (perhaps not normalised).
        translation: (3,) of the same transform.
        point_ids: (M,) ids of the observed points, -1 for keypoints without one.
    """

    image_id: int
    name: str
    camera_id: int
    quaternion: Float64
    translation: Float64
    point_ids: Int64


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """A COLMAP model.

    Attributes:
        point_ids, points, colors: (P,) ids, (P, 3) positions, (P, 3) uint8 sRGB.
        track_rows, track_images: (T,) rows of `points` and ids of the photos that observe them;
            read only when no photo tells what it observes, else empty.
    """

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    point_ids: Int64
    points: Float64
    colors: NDArray[np.uint8]
    track_rows: Int64
    track_images: Int64


def model_suffix(folder: Path) -> str | None:
    """`.bin` or `.txt` when `folder` holds a model's cameras and images in that form, else None."""
    for suffix in (".bin", ".txt"):
        if all((folder / (stem + suffix)).is_file() for stem in ("cameras", "images")):
            return suffix
    return None


def read_model(folder: Path, check: Check = go_on) -> Model:
    """The model in `folder`, binary files before text ones.

    Args: `check`: called while reading; may raise to stop.

    Raises:
        SceneError: a file is missing, unreadable or damaged.
    """
    suffix = model_suffix(folder)
    if suffix is None:
        raise SceneError(
            f"{folder} holds no COLMAP model.",
            "It needs cameras, images and points3D, all .bin or all .txt.",
        )
    paths = [folder / (stem + suffix) for stem in ("cameras", "images", "points3D")]
    if not paths[2].is_file():
        raise SceneError(f"{folder} holds no {paths[2].name}.", "Export the 3D points as well.")
    binary = suffix == ".bin"
    cameras = _read(paths[0], _cameras_bin if binary else _cameras_txt)
    images = _read(paths[1], partial(_images_bin if binary else _images_txt, check=check))
    # Normally the photos tell what they observe; the points' side is read only where they do not.
    tracks = not any((image.point_ids >= 0).any() for image in images)
    parse = partial(_points_bin if binary else _points_txt, tracks=tracks, check=check)
    ids, points, colors, rows, viewers = _read(paths[2], parse)
    return Model(
        cameras=cameras,
        images=images,
        point_ids=ids,
        points=points,
        colors=colors,
        track_rows=rows,
        track_images=viewers,
    )


def count_images(folder: Path) -> int:
    """How many posed photos the model in `folder` says it holds; 0 when that cannot be read."""
    path = folder / f"images{model_suffix(folder)}"
    try:
        if path.suffix == ".bin":
            with path.open("rb") as file:
                number = int(struct.unpack("<Q", file.read(8))[0])
            return number if number * SMALLEST_IMAGE <= path.stat().st_size else 0
        return sum(1 for _ in _image_lines(path.read_bytes()))
    except (OSError, struct.error):
        return 0


def _read(path: Path, parse: Callable[[bytes], T]) -> T:
    """`parse` of the file's bytes; whatever goes wrong becomes one line that names the file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"Cannot read {path} ({error.strerror}).") from error
    try:
        return parse(data)
    except struct.error as error:
        raise SceneError(f"{path} ends too early ({len(data)} bytes).", HINT_DAMAGED) from error
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"Cannot read {path} ({error}).", HINT_DAMAGED) from error


def _camera(model: str, width: int, height: int, params: tuple[float, ...]) -> ModelCamera:
    """A checked camera; ValueError when its numbers cannot be a camera's."""
    if model not in PARAMETER_COUNT:
        raise ValueError(f"unknown camera model {model}")
    if len(params) != PARAMETER_COUNT[model]:
        raise ValueError(f"{model} camera with {len(params)} parameters")
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
        raise ValueError(f"camera of {width} x {height} pixels")
    focals = params[: 1 if model in ONE_FOCAL else 2]
    if not (np.abs(params) < FAR).all() or min(focals) <= 0:  # nor is it for NaN
        raise ValueError(f"{model} camera with parameters {params}")
    return ModelCamera(model=model, width=width, height=height, params=params)


# --- binary ---------------------------------------------------------------------------------------


def _unpack(data: bytes, offset: int, form: str) -> tuple[tuple[int | float, ...], int]:
    """Little-endian values at `offset` and the offset after them; struct.error past the end."""
    return struct.unpack_from("<" + form, data, offset), offset + struct.calcsize("<" + form)


def _count(data: bytes, offset: int, smallest: int) -> tuple[int, int]:
    """A count of records of at least `smallest` bytes; ValueError when they cannot be there."""
    (number,), offset = _unpack(data, offset, "Q")
    if number * smallest > len(data) - offset:
        raise ValueError(f"it ends after {len(data)} bytes, {number} records announced")
    return int(number), offset


def _cameras_bin(data: bytes) -> dict[int, ModelCamera]:
    number, offset = _count(data, 0, 24)
    cameras = {}
    for _ in range(number):
        (camera_id, model_id, width, height), offset = _unpack(data, offset, "IiQQ")
        if not 0 <= model_id < len(CAMERA_MODELS):
            raise ValueError(f"unknown camera model {model_id}")
        name, length = CAMERA_MODELS[int(model_id)]
        params, offset = _unpack(data, offset, f"{length}d")
        cameras[int(camera_id)] = _camera(name, int(width), int(height), params)
    return cameras


def _images_bin(data: bytes, check: Check) -> list[ModelImage]:
    number, offset = _count(data, 0, SMALLEST_IMAGE)
    images = []
    for _ in range(number):
        check()
        (image_id, *pose, camera_id), offset = _unpack(data, offset, "I7dI")
        end = data.index(b"\0", offset)
        name = data[offset:end].decode("utf-8", errors="replace")
        length, offset = _count(data, end + 1, OBSERVATION.itemsize)
        observations = np.frombuffer(data, OBSERVATION, length, offset)
        offset += length * OBSERVATION.itemsize
        images.append(_image(int(image_id), pose, int(camera_id), name, observations["id"].copy()))
    return images


def _image(
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


Points = tuple[Int64, Float64, NDArray[np.uint8], Int64, Int64]


def _points_bin(data: bytes, tracks: bool, check: Check) -> Points:
    number, offset = _count(data, 0, POINT_HEAD.itemsize)
    size, length_at = POINT_HEAD.itemsize, POINT_HEAD.itemsize - 8
    starts = np.empty(number, dtype=np.int64)
    # Millions of turns, so nothing here that could be left out: a track that ends past the file
    # makes the next head, or the check below, do so too.
    length_of = struct.Struct("<Q").unpack_from
    for row in range(number):
        starts[row] = offset
        offset += size + 8 * length_of(data, offset + length_at)[0]
        if not row % 100_000:
            check()
    if offset > len(data):
        raise ValueError(f"it ends after {len(data)} bytes, {number} records announced")
    raw = np.frombuffer(data, dtype=np.uint8)
    heads = _gather(raw, starts, size).view(POINT_HEAD)
    ids, points, colors = heads["id"].copy(), heads["xyz"].copy(), heads["rgb"].copy()
    if not tracks:
        return ids, points, colors, NO_IDS, NO_IDS
    lengths = heads["length"].astype(np.int64)
    # The image id is the first uint32 of each pair of a track.
    first = np.repeat(starts + size - 8 * (np.cumsum(lengths) - lengths), lengths)
    at = first + 8 * np.arange(lengths.sum())
    viewers = _gather(raw, at, 4).view("<u4").astype(np.int64)
    return ids, points, colors, np.repeat(np.arange(number), lengths), viewers


def _gather(raw: NDArray[np.uint8], starts: Int64, size: int) -> NDArray[np.uint8]:
    """The `size` bytes at each of the (N,) `starts`, after one another."""
    gathered = np.empty((len(starts), size), dtype=np.uint8)
    for row in range(0, len(starts), ROWS_AT_ONCE):
        rows = slice(row, row + ROWS_AT_ONCE)
        gathered[rows] = raw[starts[rows, None] + np.arange(size)]
    return gathered.reshape(-1)


# --- text -----------------------------------------------------------------------------------------


def _lines(data: bytes) -> list[str]:
    """All lines, stripped, without comments (blank ones stay: images.txt gives them a meaning)."""
    text = data.decode("utf-8-sig", errors="replace")
    stripped = (line.strip() for line in text.split("\n"))
    return [line for line in stripped if not line.startswith("#")]


def _image_lines(data: bytes) -> Iterator[tuple[str, str]]:
    """Per photo its two lines: pose and name, observations (perhaps blank)."""
    lines = iter(_lines(data))
    for line in lines:
        if line:
            yield line, next(lines, "")


def _parsed(line: str, parse: Callable[[list[str]], T], fields: int = -1) -> T:
    """`parse` of the line's words; ValueError that quotes the line when it does not fit."""
    try:
        return parse(line.split(maxsplit=fields))
    except (ValueError, IndexError) as error:
        raise ValueError(f"at «{line[:60]}»: {error}") from error


def _cameras_txt(data: bytes) -> dict[int, ModelCamera]:
    def parse(words: list[str]) -> tuple[int, ModelCamera]:
        camera_id, model, width, height, *params = words
        values = tuple(float(value) for value in params)
        return int(camera_id), _camera(model, int(width), int(height), values)

    return dict(_parsed(line, parse) for line in filter(None, _lines(data)))


def _images_txt(data: bytes, check: Check) -> list[ModelImage]:
    images = []
    for head, tail in _image_lines(data):
        check()
        ids = _parsed(tail, lambda words: [int(value) for value in words[2::3]])
        point_ids = np.array(ids, dtype=np.int64)

        def parse(words: list[str], point_ids: Int64 = point_ids) -> ModelImage:
            image_id, *pose, camera_id, name = words
            numbers = [float(value) for value in pose]
            return _image(int(image_id), numbers, int(camera_id), name, point_ids)

        images.append(_parsed(head, parse, 9))
    return images


def _points_txt(data: bytes, tracks: bool, check: Check) -> Points:
    def parse(words: list[str]) -> tuple[int, list[float], list[int]]:
        check()
        numbers = [float(value) for value in words[1:7]]
        if len(numbers) != 6 or not np.isfinite(numbers[3:]).all():
            raise ValueError("a point needs a position and a colour")
        return int(words[0]), numbers, [int(value) for value in words[8::2]] * tracks

    parsed = [_parsed(line, parse) for line in filter(None, _lines(data))]
    table = np.array([numbers for _, numbers, _ in parsed], dtype=np.float64).reshape(-1, 6)
    colors = np.clip(table[:, 3:], 0, 255).astype(np.uint8)
    ids = np.array([point_id for point_id, _, _ in parsed], dtype=np.int64)
    rows = np.repeat(np.arange(len(parsed)), [len(track) for _, _, track in parsed])
    viewers = np.array([viewer for _, _, track in parsed for viewer in track], dtype=np.int64)
    return ids, table[:, :3].copy(), colors, rows.astype(np.int64), viewers
