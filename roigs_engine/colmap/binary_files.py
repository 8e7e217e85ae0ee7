"""COLMAP's binary model files. Counts are checked before memory is allocated."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from ..context import Context
from ..model.scene import Int64
from .records import (
    CAMERA_MODELS,
    NO_IDS,
    ModelCamera,
    ModelImage,
    Points,
    checked_camera,
    checked_image,
)

# One point of points3D.bin without its track, which follows as (image id, index) pairs of uint32.
POINT_HEAD = np.dtype(
    [("id", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")]
)
ROWS_AT_ONCE = 1 << 14  # rows gathered at a time: the index takes 8 bytes for each of their bytes
SMALLEST_IMAGE = 73  # bytes of a photo in images.bin with an empty name and no observations
OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])


def _unpack(data: bytes, offset: int, form: str) -> tuple[tuple[int | float, ...], int]:
    """Little-endian values at `offset` and the offset after them; struct.error past the end."""
    return struct.unpack_from("<" + form, data, offset), offset + struct.calcsize("<" + form)


def _count(data: bytes, offset: int, smallest: int) -> tuple[int, int]:
    """A count of records of at least `smallest` bytes; ValueError if the file is too short."""
    (number,), offset = _unpack(data, offset, "Q")
    if number * smallest > len(data) - offset:
        raise ValueError(f"it should have {number} records, but ends after {len(data)} bytes")
    return int(number), offset


def read_cameras(data: bytes) -> dict[int, ModelCamera]:
    """Camera id -> camera, from cameras.bin."""
    number, offset = _count(data, 0, 24)
    cameras = {}
    for _ in range(number):
        (camera_id, model_id, width, height), offset = _unpack(data, offset, "IiQQ")
        if not 0 <= model_id < len(CAMERA_MODELS):
            raise ValueError(f"unknown camera model {model_id}")
        name, length = CAMERA_MODELS[int(model_id)]
        params, offset = _unpack(data, offset, f"{length}d")
        cameras[int(camera_id)] = checked_camera(name, int(width), int(height), params)
    return cameras


def read_images(data: bytes, context: Context) -> list[ModelImage]:
    """The photos of images.bin."""
    number, offset = _count(data, 0, SMALLEST_IMAGE)
    images = []
    for _ in range(number):
        context.check_cancelled()
        (image_id, *pose, camera_id), offset = _unpack(data, offset, "I7dI")
        end = data.index(b"\0", offset)
        name = data[offset:end].decode("utf-8", errors="replace")
        length, offset = _count(data, end + 1, OBSERVATION.itemsize)
        observations = np.frombuffer(data, OBSERVATION, length, offset)
        offset += length * OBSERVATION.itemsize
        images.append(
            checked_image(int(image_id), pose, int(camera_id), name, observations["id"].copy())
        )
    return images


def read_points(data: bytes, tracks: bool, context: Context) -> Points:
    """The points of points3D.bin, with their tracks if `tracks`."""
    number, offset = _count(data, 0, POINT_HEAD.itemsize)
    size, length_at = POINT_HEAD.itemsize, POINT_HEAD.itemsize - 8
    starts = np.empty(number, dtype=np.int64)
    # Millions of iterations, so only the necessary work: if a track ends past the end of the file,
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


def _gather(raw: NDArray[np.uint8], starts: Int64, size: int) -> NDArray[np.uint8]:
    """The `size` bytes at each of the (N,) `starts`, concatenated."""
    gathered = np.empty((len(starts), size), dtype=np.uint8)
    for row in range(0, len(starts), ROWS_AT_ONCE):
        rows = slice(row, row + ROWS_AT_ONCE)
        gathered[rows] = raw[starts[rows, None] + np.arange(size)]
    return gathered.reshape(-1)
