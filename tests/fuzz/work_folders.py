"""Family: folders of `reconstruct` that somebody else has written to, without pycolmap's work."""

from __future__ import annotations

import json
import random
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roigs_engine.app.outputs import Result
from roigs_engine.context import Context
from roigs_engine.reconstruction import database
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import look_at
from roigs_engine.requests.declare import Request, option
from roigs_engine.requests.values import PATH
from tests.fuzz.cases import Case, good_photos, json_bytes, odd_tree, write
from tests.fuzz.damage import ODD_VALUES, bytes_damaged

TABLES = {
    "images": ("image_id", "name", "camera_id"),
    "keypoints": ("image_id", "rows", "cols", "data"),
    "descriptors": ("image_id", "rows", "cols", "data"),
    "two_view_geometries": ("pair_id", "rows", "config"),
}
PLACES = (
    *("sparse", "sparse/0", "images", "reconstruction", "database.db", "database.db-wal"),
    *(f"reconstruction/{name}" for name in ("models", "models/first", "snapshots", "earlier")),
    *(f"reconstruction/{name}" for name in ("log.txt", "state.json", "photos.json", "masks")),
)


@dataclass(frozen=True, kw_only=True)
class Resumed(Request):
    """A folder of `reconstruct`."""

    out: Path = option(PATH, "folder", required=True, flags=())


def resume(request: Any, context: Context) -> Result:
    """All that `reconstruct` does in its folder but pycolmap's work."""
    folder = Folder(request.out)
    files = folder.photos_of(request.out.parent.parent / "in" / "photos")
    with folder.held(context.warn):
        found = look_at(files, folder.work("photos.json"), context)
        folder.take_photos(found.photos)
        folder.begin(found.photos, {})
        if folder.database.exists():
            database.feature_counts(folder.database)
            database.camera_ids(folder.database)
            database.matched_pairs(folder.database)
            database.pair_kinds(folder.database)
            list(database.largest_features(folder.database, 10))
        model = folder.emptied("models", "first")
        (model / "images.bin").write_bytes(b"made")
        folder.take_model(model)
        folder.finish("key")
    return Result()


def write_database(dice: random.Random, path: Path) -> None:
    """A small database as COLMAP's, with odd values."""
    with closing(sqlite3.connect(path)) as file, file:
        for table, columns in TABLES.items():
            file.execute(f"CREATE TABLE {table} ({', '.join(columns)})")
        for number in (1, 2):
            file.execute("INSERT INTO images VALUES (?, ?, 1)", (number, f"{number}.png"))
            for table, size in (("keypoints", 6), ("descriptors", 32)):
                row = (number, 2, size if size == 6 else 128, bytes(8 * size))
                file.execute(f"INSERT INTO {table} VALUES (?, ?, ?, ?)", row)
        pair = database.PAIR_BASE + 2
        file.execute("INSERT INTO two_view_geometries VALUES (?, 20, 2)", (pair,))
        for _ in range(dice.choice((0, 1, 1, 3))):
            table = dice.choice(list(TABLES))
            column, value = dice.choice(TABLES[table]), dice.choice(ODD_VALUES)
            with suppress(sqlite3.Error, OverflowError, UnicodeError):  # SQLite has none such
                file.execute(f"UPDATE {table} SET {column} = ?", (value,))
    if dice.random() < 0.2:
        path.write_bytes(bytes_damaged(dice, path.read_bytes()))


def work_folders(dice: random.Random, folder: Path) -> Case:
    """A folder with a damaged database and record, and links to the user's files and folders."""
    for name, data in good_photos().items():
        write(folder / "in" / "photos" / name, data)
    write(folder / "in" / "theirs" / "0" / "images.bin", b"theirs")
    out = folder / "out" / "scene"
    state: Any = {"version": 1, "features": {}, "photos": {}, "done": ""}
    if dice.random() < 0.3:
        state = odd_tree(dice, state)
    data = json.dumps(state).encode() if dice.random() < 0.7 else json_bytes(dice, state)
    write(out / "reconstruction" / "state.json", data)
    write_database(dice, out / "database.db")
    if dice.random() < 0.5:
        place = out / dice.choice(PLACES)
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.is_dir():
            place.rename(folder / "in" / "moved")
        place.unlink(missing_ok=True)
        targets = ("theirs", "theirs/0/images.bin", "nowhere", *(["moved"] * 3))
        place.symlink_to(folder / "in" / dice.choice(targets))
    return Case(["resume", str(out)])


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "work_folders": (work_folders, 300)
}
