"""Queries COLMAP's database, which pycolmap may be writing at the same time."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..formats.text import first_line

# COLMAP splits lines of pairs at the first space, and skips lines that begin with #.
HIDDEN = {" ": "\x1f", "#": "\x1e"}
PAIR_BASE = 2147483647  # in COLMAP, a pair's id is smaller id * base + larger id
FEWEST_INLIERS = 15  # matches of a pair for COLMAP's mapper
# COLMAP's kinds of pairs. PANORAMIC: the camera only turned, or saw a plane (these cannot always be
# told apart). STILL: the matches do not move in the picture, like a watermark or a background.
PANORAMIC = (5, 6)
STILL = (7,)
COMPUTES = re.compile(r"\bVIRTUAL\b|\bAS\s*\(|(blob|printf|format)\s*\(|/\*|--", re.IGNORECASE)
"""Matches SQL of a table or an index with computed values, or with comments that may hide them."""
Pair = tuple[str, str]


@contextmanager
def _opened(database: Path) -> Iterator[sqlite3.Connection]:
    """Open the database to read; SceneError if it is damaged."""
    address = f"{database.absolute().as_uri()}?mode=ro"
    with _explained(database), closing(sqlite3.connect(address, uri=True)) as file:
        if any(starmap(_computes, file.execute("SELECT type, sql FROM sqlite_master"))):
            raise ValueError("it is not as COLMAP makes it")
        yield file


def _computes(kind: object, sql: object) -> bool:
    """Whether part of a database may use unlimited time or memory; COLMAP makes no such parts.

    Queries of views and triggers may never end, and functions can make values of a gigabyte.
    """
    return kind in ("view", "trigger") or COMPUTES.search(str(sql or "")) is not None


@contextmanager
def _explained(database: Path) -> Iterator[None]:
    """Turn errors of SQLite, and of values that COLMAP never writes, into a SceneError."""
    try:
        yield
    except (sqlite3.Error, TypeError, ValueError, LookupError, ArithmeticError) as error:
        raise SceneError(
            f"Cannot use {database} ({first_line(error):.100}).",
            "Free some space if the disk is full; else delete it and give the command again.",
        ) from error


def _rows(file: sqlite3.Connection, query: str, *kinds: type) -> Iterator[Any]:
    """Yield the rows of a query; TypeError for values of other types, which SQLite allows."""
    for row in file.execute(query):
        if tuple(map(type, row)) != kinds:
            raise TypeError("it has values of other types than COLMAP writes")
        yield row


def feature_counts(database: Path) -> dict[str, int]:
    """Photo -> number of its features, for the photos already searched for features."""
    query = "SELECT name, rows FROM images JOIN descriptors USING (image_id)"
    with _opened(database) as file:
        return dict(_rows(file, query, str, int))


def numbers(database: Path) -> dict[str, tuple[int, int]]:
    """Photo -> its id and number of features, for the photos already searched for features."""
    query = "SELECT name, image_id, rows FROM images JOIN keypoints USING (image_id)"
    with _opened(database) as file:
        return {name: (key, rows) for name, key, rows in _rows(file, query, str, int, int)}


def camera_ids(database: Path) -> dict[str, int]:
    """Photo -> id of its camera."""
    with _opened(database) as file:
        return dict(_rows(file, "SELECT name, camera_id FROM images", str, int))


def count(database: Path, table: str) -> int:
    """The number of rows of a table; 0 while there is no such table.

    It is for progress only, so it never raises.
    """
    try:
        with _opened(database) as file:
            return int(file.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
    except SceneError:
        return 0


def matched_pairs(database: Path) -> dict[Pair, int]:
    """Names of two photos, in order -> number of verified matches, for all tried pairs."""
    return _pairs_of(database, "two_view_geometries")


def match_counts(database: Path) -> dict[Pair, int]:
    """Names of two photos, in order -> number of unverified matches."""
    return _pairs_of(database, "matches")


def _pairs_of(database: Path, table: str) -> dict[Pair, int]:
    found = {}
    with _opened(database) as file:
        names = dict(_rows(file, "SELECT image_id, name FROM images", int, str))
        for pair, matches in _rows(file, f"SELECT pair_id, rows FROM {table}", int, int):
            one, other = sorted(names[key] for key in divmod(pair, PAIR_BASE))
            found[one, other] = matches
    return found


def pair_kinds(database: Path) -> Counter[int]:
    """Number of verified pairs of each kind: `PANORAMIC`, `STILL`, or another of COLMAP's."""
    query = "SELECT config, rows FROM two_view_geometries"
    with _opened(database) as file:
        pairs = _rows(file, query, int, int)
        return Counter(config for config, matches in pairs if matches >= FEWEST_INLIERS)


def largest_features(database: Path, most: int) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield each photo's name and (N, 128) descriptors, N at most `most`, largest scales first."""
    query = (
        "SELECT name, keypoints.rows, keypoints.cols, coalesce(keypoints.data, x''),"
        " coalesce(descriptors.data, x'')"
        " FROM images JOIN keypoints USING (image_id) JOIN descriptors USING (image_id)"
        " ORDER BY name"
    )
    with _opened(database) as file:
        for name, rows, columns, points, data in _rows(file, query, str, int, int, bytes, bytes):
            shape = np.frombuffer(points, dtype=np.float32).reshape(max(rows, 0), columns)[:, 2:6]
            with np.errstate(invalid="ignore", over="ignore"):
                scale = np.abs(shape[:, 0] * shape[:, 3] - shape[:, 1] * shape[:, 2])
            largest = np.argsort(-scale, kind="stable")[:most]
            descriptors = np.frombuffer(data, dtype=np.uint8).reshape(rows, 128)
            yield name, descriptors[largest]


def pair_line(pair: Pair) -> str:
    """The line of a pair in a list for COLMAP, while spaces are hidden."""
    one, other = ("".join(HIDDEN.get(letter, letter) for letter in name) for name in pair)
    return f"{one} {other}\n"


@contextmanager
def spaces_hidden(database: Path) -> Iterator[None]:
    """Change names in the database as in `pair_line` while the block runs."""
    _rename(database, HIDDEN)
    try:
        yield
    finally:
        show_spaces(database)


def show_spaces(database: Path) -> None:
    """Undo `spaces_hidden`, also after a killed process."""
    if database.exists():
        _rename(database, {hidden: letter for letter, hidden in HIDDEN.items()})


def _rename(database: Path, letters: dict[str, str]) -> None:
    with _explained(database), closing(sqlite3.connect(database, timeout=60)) as file, file:
        if file.execute("SELECT 1 FROM sqlite_master WHERE name = 'images'").fetchone():
            for old, new in letters.items():
                query = "UPDATE images SET name = replace(name, ?, ?) WHERE instr(name, ?)"
                file.execute(query, (old, new, old))
