"""Readers of COLMAP's model files, binary and text, as plain arrays.

pycolmap's reader is not used: on damaged files it can loop forever or allocate huge amounts of
memory, and it rejects a model with a single dangling observation. Here, counts are checked before
memory is allocated. `rigs` and `frames` files are not needed, since `images` has each photo's full
pose. Files for pycolmap are checked here first (`pycolmap_model`).
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.files import UNREADABLE, read_bytes, regular
from ..formats.projects import model_suffix
from ..formats.text import decode_text
from ..model.scene import Int64
from .records import (
    CAMERA_MODELS,
    KNOWN_IDS,
    NO_IDS,
    Model,
    ModelCamera,
    ModelImage,
    Points,
    UnknownCameraError,
    checked_camera,
    checked_image,
    relative_names,
)

T = TypeVar("T")

HINT_CAMERAS = (
    "Use a model with COLMAP's cameras (PINHOLE, OPENCV, OPENCV_FISHEYE ...); cut panoramas into"
    " perspective photos before."
)
HINT_DAMAGED = "The file is damaged or incomplete: export the model again."


def read_model(folder: Path, context: Context = QUIET) -> Model:
    """Read the model in `folder`; binary files take precedence over text files.

    Args: `context`: checked for cancellation while reading.

    Raises:
        SceneError: a file is missing, unreadable or damaged.
    """
    suffix = _suffix(folder)
    read_cameras, _, read_points = _READERS[suffix]
    points3d = folder / f"points3D{suffix}"
    if not points3d.is_file():
        raise SceneError(f"{folder} has no {points3d.name}.", "Export the 3D points as well.")
    cameras = _read(folder / f"cameras{suffix}", read_cameras)
    images = read_images(folder, context)
    # Usually, the photos list their observations. If not, read the points' tracks.
    tracks = not any((image.point_ids >= 0).any() for image in images)
    points = _read(points3d, lambda data: read_points(data, tracks, context))
    return Model(cameras, images, *points)


def pycolmap_model(colmap: Any, folder: Path, context: Context = QUIET) -> tuple[Model, Any]:
    """Read the model in `folder` with `read_model` and with pycolmap.

    Poses and points that are not finite are removed from pycolmap's model. Raises SceneError as
    `read_model`, and also for the model's other files that pycolmap reads.
    """
    model = read_model(folder, context)
    for path in filter(os.path.lexists, (folder / name for name in _CHECKS)):
        _read(path, _CHECKS[path.name])
    found = colmap.Reconstruction(str(folder))
    for key in found.reg_frame_ids():
        pose = found.frame(key).rig_from_world
        if not (np.isfinite(pose.matrix()).all() and np.any(pose.rotation.quat)):
            found.deregister_frame(key)  # pycolmap aborts the process at such a pose
    for key in found.point3D_ids():
        if not np.isfinite(found.points3D[key].xyz).all():
            found.delete_point3D(key)
    return model, found


def read_images(folder: Path, context: Context = QUIET) -> list[ModelImage]:
    """Read only a model's photos; names as from `relative_names`, errors as `read_model`."""
    suffix = _suffix(folder)
    _, read, _ = _READERS[suffix]
    images = _read(folder / f"images{suffix}", lambda data: read(data, context))
    names = relative_names([image.name for image in images])
    return [replace(image, name=name) for image, name in zip(images, names, strict=True)]


def _suffix(folder: Path) -> str:
    """The suffix of a model's files, a key of `_READERS`."""
    suffix = model_suffix(folder)
    if suffix is None:
        raise SceneError(
            f"{folder} has no COLMAP model.",
            "It needs cameras, images and points3D, all .bin or all .txt.",
        )
    return suffix


def count_images(folder: Path) -> int:
    """The number of posed photos in the model in `folder`; 0 if it cannot be read."""
    path = folder / f"images{model_suffix(folder)}"
    try:
        if path.suffix == ".bin":
            with open(path, "rb", opener=regular) as file:
                number = int(struct.unpack("<Q", file.read(8))[0])
            return number if number * SMALLEST_IMAGE <= path.stat().st_size else 0
        return sum(1 for _ in _image_lines(read_bytes(path, most=None)))
    except (OSError, ValueError, struct.error):
        return 0


def _read(path: Path, parse: Callable[[bytes], T]) -> T:
    """Apply `parse` to the file's bytes; any error becomes a SceneError that names the file."""
    try:
        data = read_bytes(path, most=None)
    except OSError as error:
        raise SceneError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    try:
        return parse(data)
    except struct.error as error:
        raise SceneError(f"{path} ends too early ({len(data)} bytes).", HINT_DAMAGED) from error
    except UnknownCameraError as error:
        raise SceneError(f"Cannot use {path}: {error}.", HINT_CAMERAS) from error
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"Cannot read {path} ({error}).", HINT_DAMAGED) from error


# A point of points3D.bin without its track; the track follows as (image id, index) uint32 pairs.
POINT_HEAD = np.dtype(
    [("id", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")]
)
ROWS_AT_ONCE = 1 << 14  # rows gathered at a time; each byte of a row needs an index of 8 bytes
MOST_LINE = 16 << 20
"""Bytes of a line of a text model: enough for half a million observations of a photo."""
FIRST_CAMERA = 32  # offset of the first camera's parameters
FIRST_NEW = 11  # COLMAP added models from this id on; forks already used these ids
MOST_PARAMETERS = 20
SMALLEST_IMAGE = 73  # bytes of a photo in images.bin with an empty name and no observations
OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])


def _unpack(data: bytes, offset: int, form: str) -> tuple[tuple[int | float, ...], int]:
    """Little-endian values at `offset` and the offset after them; struct.error past the end."""
    return struct.unpack_from("<" + form, data, offset), offset + struct.calcsize("<" + form)


def _record_count(data: bytes, offset: int, smallest: int) -> tuple[int, int]:
    """A count of records of at least `smallest` bytes; ValueError if the file is too short."""
    (number,), offset = _unpack(data, offset, "Q")
    if number * smallest > len(data) - offset:
        raise ValueError(f"it should have {number} records, but ends after {len(data)} bytes")
    return int(number), offset


def _binary_cameras(data: bytes) -> dict[int, ModelCamera]:
    number, offset = _record_count(data, 0, 24)
    cameras = {}
    for _ in range(number):
        (camera_id, model_id, width, height), offset = _unpack(data, offset, "IiQQ")
        if not 0 <= model_id < len(CAMERA_MODELS):
            if len(CAMERA_MODELS) <= model_id < KNOWN_IDS:
                raise UnknownCameraError(f"cameras of model {model_id} are not supported")
            raise ValueError(f"no camera model has the number {model_id}")
        name, length = CAMERA_MODELS[int(model_id)]
        if model_id >= FIRST_NEW and offset == FIRST_CAMERA:
            _check_parameters(name, length, (len(data) - 8) / number - 24)
        params, offset = _unpack(data, offset, f"{length}d")
        cameras[int(camera_id)] = checked_camera(name, int(width), int(height), params)
    return cameras


def _check_parameters(name: str, length: int, size: float) -> None:
    """Raise UnknownCameraError if a new model's cameras do not have COLMAP's parameter count.

    Forks used these ids for models of their own before COLMAP did (SphereSfM's SPHERE).
    `size`: bytes of a camera's parameters.
    """
    if size != 8 * length and size % 8 == 0 and 0 < size < 8 * MOST_PARAMETERS:
        count = int(size / 8)
        raise UnknownCameraError(f"its cameras have {count} parameters, {name} has {length}")


def _binary_images(data: bytes, context: Context) -> list[ModelImage]:
    number, offset = _record_count(data, 0, SMALLEST_IMAGE)
    images = []
    for _ in range(number):
        context.check_cancelled()
        (image_id, *pose, camera_id), offset = _unpack(data, offset, "I7dI")
        end = data.index(b"\0", offset)
        name = data[offset:end].decode("utf-8", errors="replace")
        length, offset = _record_count(data, end + 1, OBSERVATION.itemsize)
        observations = np.frombuffer(data, OBSERVATION, length, offset)
        offset += length * OBSERVATION.itemsize
        images.append(
            checked_image(int(image_id), pose, int(camera_id), name, observations["id"].copy())
        )
    return images


def _binary_points(data: bytes, tracks: bool, context: Context) -> Points:
    number, offset = _record_count(data, 0, POINT_HEAD.itemsize)
    size, length_at = POINT_HEAD.itemsize, POINT_HEAD.itemsize - 8
    heads = np.frombuffer(data, POINT_HEAD, number, offset)
    if not heads["length"].any():  # no tracks
        return heads["id"].copy(), heads["xyz"].copy(), heads["rgb"].copy(), NO_IDS, NO_IDS
    starts = np.empty(number, dtype=np.int64)
    # No check in this loop of millions of iterations: if a track ends past the end of the file,
    # reading the next head or the check below fails.
    length_of = struct.Struct("<Q").unpack_from
    for row in range(number):
        starts[row] = offset
        offset += size + 8 * length_of(data, offset + length_at)[0]
        if not row % 100_000:
            context.check_cancelled()
    if offset > len(data):
        raise ValueError(f"it should have {number} records, but ends after {len(data)} bytes")
    raw = np.frombuffer(data, dtype=np.uint8)
    heads = _gather(raw, starts, size).view(POINT_HEAD)
    ids, points, colors = heads["id"].copy(), heads["xyz"].copy(), heads["rgb"].copy()
    if not tracks:
        return ids, points, colors, NO_IDS, NO_IDS
    lengths = heads["length"].astype(np.int64)
    # The image id is the first uint32 of each pair in a track.
    first = np.repeat(starts + size - 8 * (np.cumsum(lengths) - lengths), lengths)
    at = first + 8 * np.arange(lengths.sum())
    viewers = _gather(raw, at, 4).view("<u4").astype(np.int64)
    return ids, points, colors, np.repeat(np.arange(number), lengths), viewers


def _check_rigs(data: bytes) -> None:
    number, offset = _record_count(data, 0, 8)
    for _ in range(number):
        (_, sensors), offset = _unpack(data, offset, "II")
        offset += 8 * (sensors > 0)  # the first sensor has no pose
        for _ in range(int(sensors) - 1):
            (*_, is_posed), offset = _unpack(data, offset, "iIB")
            offset += 56 * bool(is_posed)


def _check_frames(data: bytes) -> None:
    number, offset = _record_count(data, 0, 68)
    for _ in range(number):
        (photos,), offset = _unpack(data, offset + 64, "I")
        offset += 16 * int(photos)
    if offset > len(data):
        raise ValueError(f"it should have {number} records, but ends after {len(data)} bytes")


_CHECKS = {"rigs.bin": _check_rigs, "frames.bin": _check_frames}


def _gather(raw: NDArray[np.uint8], starts: Int64, size: int) -> NDArray[np.uint8]:
    """The `size` bytes at each of the (N,) `starts`, concatenated."""
    gathered = np.empty((len(starts), size), dtype=np.uint8)
    for row in range(0, len(starts), ROWS_AT_ONCE):
        rows = slice(row, row + ROWS_AT_ONCE)
        gathered[rows] = raw[starts[rows, None] + np.arange(size)]
    return gathered.reshape(-1)


def _text_lines(data: bytes) -> Iterator[str]:
    """Yield all lines, stripped, without comments. Blank lines stay: images.txt needs them.

    ValueError: the text has another encoding, or a line is far too long.
    """
    decode_text(data[:4096], replace=True)
    for raw in io.BytesIO(data):  # not all lines as str: they take many times the memory
        if len(raw) > MOST_LINE:
            raise ValueError(f"a line has {len(raw) >> 20} MB")
        line = raw.decode("utf-8", "replace").removeprefix("\ufeff").strip()
        if not line.startswith("#"):
            yield line


def _image_lines(data: bytes) -> Iterator[tuple[str, str]]:
    """Yield the two lines of each photo: pose and name; observations (may be blank)."""
    lines = _text_lines(data)
    for line in lines:
        if line:
            yield line, next(lines, "")


def _parsed(line: str, parse: Callable[[list[str]], T], fields: int = -1) -> T:
    """Apply `parse` to the line's words; a ValueError quotes the line if it is malformed."""
    try:
        return parse(line.split(maxsplit=fields))
    except UnknownCameraError:
        raise
    except (ValueError, IndexError) as error:
        raise ValueError(f"at '{line[:60]}': {error}") from error


def _text_cameras(data: bytes) -> dict[int, ModelCamera]:

    def parse(words: list[str]) -> tuple[int, ModelCamera]:
        camera_id, model, width, height, *params = words
        values = tuple(float(value) for value in params)
        return int(camera_id), checked_camera(model, int(width), int(height), values)

    return dict(_parsed(line, parse) for line in filter(None, _text_lines(data)))


def _text_images(data: bytes, context: Context) -> list[ModelImage]:
    images = []
    for head, tail in _image_lines(data):
        context.check_cancelled()
        ids = _parsed(tail, lambda words: [int(value) for value in words[2::3]])
        point_ids = np.array(ids, dtype=np.int64)

        def parse(words: list[str], point_ids: Int64 = point_ids) -> ModelImage:
            image_id, *pose, camera_id, name = words
            numbers = [float(value) for value in pose]
            return checked_image(int(image_id), numbers, int(camera_id), name, point_ids)

        images.append(_parsed(head, parse, 9))
    return images


def _text_points(data: bytes, tracks: bool, context: Context) -> Points:

    def parse(words: list[str]) -> tuple[int, list[float], list[int]]:
        context.check_cancelled()
        numbers = [float(value) for value in words[1:7]]
        if len(numbers) != 6 or not np.isfinite(numbers[3:]).all():
            raise ValueError("a point needs a position and a colour")
        return int(words[0]), numbers, [int(value) for value in words[8::2]] * tracks

    ids, tables, counts, viewers = [NO_IDS], [np.empty((0, 6))], [NO_IDS], [NO_IDS]
    lines = filter(None, _text_lines(data))
    while parsed := [_parsed(line, parse) for line in islice(lines, ROWS_AT_ONCE)]:
        ids.append(np.array([point_id for point_id, _, _ in parsed], dtype=np.int64))
        tables.append(np.array([numbers for _, numbers, _ in parsed], dtype=np.float64))
        counts.append(np.array([len(track) for _, _, track in parsed], dtype=np.int64))
        viewers.append(np.array([v for _, _, track in parsed for v in track], dtype=np.int64))
    table, lengths = np.concatenate(tables), np.concatenate(counts)
    colors = np.clip(table[:, 3:], 0, 255).astype(np.uint8)
    rows = np.repeat(np.arange(len(lengths), dtype=np.int64), lengths)
    return np.concatenate(ids), table[:, :3].copy(), colors, rows, np.concatenate(viewers)


# By suffix. `_read` turns errors about damaged data into SceneErrors.
_READERS = {
    ".bin": (_binary_cameras, _binary_images, _binary_points),
    ".txt": (_text_cameras, _text_images, _text_points),
}
