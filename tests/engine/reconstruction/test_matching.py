"""Matching, then verification: what COLMAP does in one pass, with less work."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.reconstruction import worker
from roigs_engine.reconstruction.database import (
    FEWEST_INLIERS,
    matched_pairs,
    pair_line,
    spaces_hidden,
)
from tests.engine.reconstruction.photo_sets import copy_photos, demo_photos

pycolmap = pytest.importorskip("pycolmap")
NAMES = [f"#{number} a photo.jpg" for number in range(5)]
PAIRS = [(one, other) for row, one in enumerate(NAMES) for other in NAMES[row + 1 :]]


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Features of photos, some of which have little in common."""
    folder = tmp_path_factory.mktemp("matching")
    photos = [*demo_photos("wide/*.jpg", 3), *demo_photos("close/*.jpg", 2)]
    copy_photos(folder / "photos", photos, NAMES, 0.5)
    task = {
        "database": str(folder / "database.db"),
        "photos": str(folder / "photos"),
        "groups": [{"names": NAMES, "camera": -1}],
        "threads": 2,
        "max_side": 1600,
        "features": 1000,
        "camera_model": "SIMPLE_RADIAL",
        "masks": "",
    }
    worker.extract(pycolmap, task)
    return folder / "database.db"


@pytest.fixture(autouse=True)
def no_pairs(database: Path) -> Iterator[None]:
    """Each test begins without matches."""
    yield
    with closing(sqlite3.connect(database)) as file, file:
        file.execute("DELETE FROM matches")
        file.execute("DELETE FROM two_view_geometries")


def matched(database: Path, pairs: list[tuple[str, str]]) -> dict[int, Any]:
    """The verified matches after `worker.match` of some pairs."""
    listed = database.with_name("pairs.txt")
    listed.write_text("".join(map(pair_line, pairs)), "utf-8", newline="\n")
    task = {"database": str(database), "pairs": str(listed), "seed": 0, "threads": 2}
    worker.match(pycolmap, task)
    assert matched_pairs(database).keys() >= {*pairs}
    with closing(sqlite3.connect(database)) as file:
        found = file.execute("SELECT pair_id, rows, config, data FROM two_view_geometries")
        return {key: rest for key, *rest in found}


def test_the_inliers_are_those_of_one_pass_over_all_pairs(database: Path) -> None:
    apart = matched(database, PAIRS)
    with closing(sqlite3.connect(database)) as file, file:
        file.execute("DELETE FROM two_view_geometries")
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    with spaces_hidden(database):
        pycolmap.verify_matches(database, database.with_name("pairs.txt"), verification)
    with closing(sqlite3.connect(database)) as file:
        found = file.execute("SELECT pair_id, rows, config, data FROM two_view_geometries")
        whole = {key: rest for key, *rest in found}
    used = {key for key, (rows, *_) in whole.items() if rows >= FEWEST_INLIERS}
    assert 3 <= len(used) < len(PAIRS)
    assert {key for key, (rows, *_) in apart.items() if rows >= FEWEST_INLIERS} == used
    assert all(apart[key] == whole[key] for key in used)


def test_pairs_that_are_there_stay(database: Path) -> None:
    first = matched(database, PAIRS[:4])
    assert first.items() <= matched(database, PAIRS).items()


def test_no_share_is_above_what_a_pair_needs_to_be_used() -> None:
    lines = [pair_line(pair).rstrip("\n") for pair in PAIRS]
    counts = dict(zip(lines, range(10, 100, 9), strict=True))
    by_names = {(line.split(" ")[0], line.split(" ")[1]): counts[line] for line in lines}
    groups = worker.by_share(lines, by_names)
    assert sorted(line for same in groups.values() for line in same) == sorted(lines)
    assert len(groups) == len(worker.SHARES)
    for share, same in groups.items():
        for line in same:
            assert share <= max(FEWEST_INLIERS / max(counts[line], FEWEST_INLIERS), 0.25)
