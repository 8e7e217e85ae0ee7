"""COLMAP's text model files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from ..context import Context
from ..formats.text import decode_text
from ..model.scene import Int64
from .records import ModelCamera, ModelImage, Points, checked_camera, checked_image

T = TypeVar("T")


def _lines(data: bytes) -> list[str]:
    """All lines, stripped, without comments. Blank lines stay: in images.txt they have meaning."""
    text = decode_text(data, replace=True)
    stripped = (line.strip() for line in text.split("\n"))
    return [line for line in stripped if not line.startswith("#")]


def image_lines(data: bytes) -> Iterator[tuple[str, str]]:
    """The two lines of each photo: pose and name; observations (may be blank)."""
    lines = iter(_lines(data))
    for line in lines:
        if line:
            yield line, next(lines, "")


def _parsed(line: str, parse: Callable[[list[str]], T], fields: int = -1) -> T:
    """`parse` of the line's words; a ValueError quotes the line if it is malformed."""
    try:
        return parse(line.split(maxsplit=fields))
    except (ValueError, IndexError) as error:
        raise ValueError(f"at '{line[:60]}': {error}") from error


def read_cameras(data: bytes) -> dict[int, ModelCamera]:
    """Camera id -> camera, from cameras.txt."""

    def parse(words: list[str]) -> tuple[int, ModelCamera]:
        camera_id, model, width, height, *params = words
        values = tuple(float(value) for value in params)
        return int(camera_id), checked_camera(model, int(width), int(height), values)

    return dict(_parsed(line, parse) for line in filter(None, _lines(data)))


def read_images(data: bytes, context: Context) -> list[ModelImage]:
    """The photos of images.txt."""
    images = []
    for head, tail in image_lines(data):
        context.check_cancelled()
        ids = _parsed(tail, lambda words: [int(value) for value in words[2::3]])
        point_ids = np.array(ids, dtype=np.int64)

        def parse(words: list[str], point_ids: Int64 = point_ids) -> ModelImage:
            image_id, *pose, camera_id, name = words
            numbers = [float(value) for value in pose]
            return checked_image(int(image_id), numbers, int(camera_id), name, point_ids)

        images.append(_parsed(head, parse, 9))
    return images


def read_points(data: bytes, tracks: bool, context: Context) -> Points:
    """The points of points3D.txt, with their tracks if `tracks`."""

    def parse(words: list[str]) -> tuple[int, list[float], list[int]]:
        context.check_cancelled()
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
