"""Files of scribbles (docs/files.md): strokes on photos, the input for masks of objects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from .files import read_json
from .transforms import numbers

OBJECT, BACKGROUND = "object", "background"
"""Kinds of strokes."""
MOST = 1e6  # pixels; larger numbers cannot be in a photo
MOST_POINTS = 500_000
"""In all strokes of a file: hours of painting. In a wide stroke, each takes 0.3 ms to draw."""
HINT = (
    'Give --scribbles a JSON file with a list "scribbles" of {"box", "photo", "strokes"}'
    " (docs/files.md)."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
    """One line on a photo, in pixels of the photo's file."""

    kind: str  # `OBJECT` or `BACKGROUND`
    width: float
    points: NDArray[np.float64]  # (N, 2) x and y from the photo's upper left corner; N >= 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Scribble:
    """The strokes for one box on one photo, oldest first: where they cross, the later counts."""

    box: str
    photo: str  # name in the model
    strokes: tuple[Stroke, ...]  # at least one


def read_scribbles(path: Path) -> list[Scribble]:
    """All scribbles of a file; ConfigError if it cannot be used."""
    document = read_json(path, ConfigError, HINT)
    records = document.get("scribbles") if isinstance(document, dict) else document
    if not isinstance(records, list) or not records:
        raise ConfigError(f"{path} contains no scribble.", HINT)
    try:
        found = [_scribble(record) for record in records]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path} is malformed ({error}).", HINT) from error
    points = sum(len(stroke.points) for scribble in found for stroke in scribble.strokes)
    if points > MOST_POINTS:
        raise ConfigError(
            f"{path} has {points:,} points of strokes; at most {MOST_POINTS:,} are used.",
            "Draw fewer strokes.",
        )
    pairs = [(scribble.box, scribble.photo) for scribble in found]
    if len(set(pairs)) < len(pairs):
        raise ConfigError(
            f"{path} has two scribbles for one box and photo.", "Put all strokes into one."
        )
    return found


def _scribble(record: Any) -> Scribble:
    if not isinstance(record, dict):
        raise TypeError("a scribble is an object")
    strokes = record["strokes"]
    if not isinstance(record["box"], str) or not isinstance(record["photo"], str):
        raise TypeError("names are texts")
    if not isinstance(strokes, list) or not strokes:
        raise ValueError("a scribble needs a list of strokes")
    return Scribble(box=record["box"], photo=record["photo"], strokes=tuple(map(_stroke, strokes)))


def _stroke(record: Any) -> Stroke:
    if not isinstance(record, dict):
        raise TypeError("a stroke is an object")
    if record["kind"] not in (OBJECT, BACKGROUND):
        raise ValueError(f"the kind of a stroke is '{OBJECT}' or '{BACKGROUND}'")
    width = float(numbers(record["width"], (), "width", MOST))
    if width <= 0:
        raise ValueError("the width of a stroke is more than 0")
    points = numbers(record["points"], (None, 2), "points", MOST)
    return Stroke(kind=record["kind"], width=width, points=points)
