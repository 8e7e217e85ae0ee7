"""COLMAP's database in a folder that somebody else may have written to."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.errors import SceneError
from roigs_engine.reconstruction import database

MADE = """
CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY, rows INTEGER, config INTEGER);
INSERT INTO images VALUES (1, 'a.jpg', 1), (2, 'b.jpg', 1);
INSERT INTO keypoints VALUES (1, 2, 6, zeroblob(48)), (2, 0, 6, NULL);
INSERT INTO descriptors VALUES (1, 2, 128, zeroblob(256)), (2, 0, 128, NULL);
"""
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
DAMAGE = (
    *(f"UPDATE keypoints SET {change}" for change in ("rows = 2000000000", "rows = -5")),
    *(f"UPDATE keypoints SET {change}" for change in ("cols = 100000000", "cols = 2, rows = 6")),
    *(f"UPDATE keypoints SET data = {value}" for value in ("'abc'", "7", "x'01'", "zeroblob(96)")),
    "UPDATE keypoints SET rows = 3, data = zeroblob(72)",
    *(f"UPDATE descriptors SET rows = {value}" for value in ("'x'", "NULL", "1.5", "1e300")),
    *(f"UPDATE images SET name = {value}" for value in ("NULL", "x'ff'", "CAST(x'ff' AS TEXT)")),
    "UPDATE images SET camera_id = 'x'",
    *(f"INSERT INTO two_view_geometries VALUES ({row})" for row in ("-1, 9, 2", "8, 9, 2")),
    *(f"INSERT INTO two_view_geometries VALUES ({1 << 62}, {row})" for row in ("'x', 2", "9, 'x'")),
    "DROP TABLE images",
    f"DROP TABLE images; CREATE VIEW images AS {ENDLESS} SELECT 1 image_id, x name, 1 FROM c",
    "ALTER TABLE keypoints ADD COLUMN more BLOB AS (zeroblob(1000000000))",
    "ALTER TABLE keypoints ADD COLUMN more BLOB GENERATED ALWAYS AS/**/( hex(data) )",
    "CREATE INDEX i ON images (length(zeroblob(1000000000)))",
    "CREATE TABLE t (a INTEGER CHECK (length(printf('%1000000000d', a)) > 0))",
    f"CREATE TRIGGER t AFTER INSERT ON images BEGIN DELETE FROM images; {'END'}",
)


def made(path: Path, damage: str = "") -> Path:
    with closing(sqlite3.connect(path)) as file:
        file.executescript(MADE)
        pair = database.PAIR_BASE + 2
        file.execute("INSERT INTO two_view_geometries VALUES (?, 20, 2)", (pair,))
        file.commit()
        file.executescript(damage)
    return path


def read(path: Path) -> None:
    database.feature_counts(path)
    database.camera_ids(path)
    database.matched_pairs(path)
    database.pair_kinds(path)
    list(database.largest_features(path, 10))


def test_a_whole_one_is_read(tmp_path: Path) -> None:
    whole = made(tmp_path / "database.db")
    read(whole)
    assert database.matched_pairs(whole) == {("a.jpg", "b.jpg"): 20}
    assert database.pair_kinds(whole) == {2: 1}
    shapes = {name: found.shape for name, found in database.largest_features(whole, 1)}
    assert shapes == {"a.jpg": (1, 128), "b.jpg": (0, 128)}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_one_is_one_line(tmp_path: Path, damage: str) -> None:
    damaged = made(tmp_path / "database.db", damage)
    with pytest.raises(SceneError, match=r"Cannot use .*database\.db \(") as error:
        read(damaged)
    assert "delete it and give the command again" in error.value.hint
    assert "\n" not in str(error.value)


def test_numbers_that_are_none_are_no_warning(tmp_path: Path) -> None:
    points = np.full(12, np.nan, dtype=np.float32)
    points[6:] = np.inf, 0, 1e38, 1e38, 1e38, 1e38
    path = made(tmp_path / "database.db")
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("UPDATE keypoints SET data = ? WHERE image_id = 1", (points.tobytes(),))
    read(path)
