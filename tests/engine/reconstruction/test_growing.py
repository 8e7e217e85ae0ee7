"""Models stand where an earlier model of the same photos stands."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from roigs_engine.formats.files import read_record
from roigs_engine.reconstruction import worker
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import Photo
from tests.engine.synthetic_colmap import write_project
from tests.poses import rotation


def model(folder: Path, photos: int = 6, arc: float = 2 * np.pi) -> pycolmap.Reconstruction:
    names = [f"{number}.png" for number in range(photos)]
    write_project(folder, names=names, images=None, arc=arc)
    return pycolmap.Reconstruction(str(folder / "sparse/0"))


def centres(found: pycolmap.Reconstruction) -> np.ndarray:
    images = sorted(found.images.values(), key=lambda image: image.name)
    return np.array([image.projection_center() for image in images])


def elsewhere(found: pycolmap.Reconstruction) -> None:
    """Move it, as a second run of the mapper would."""
    turn = pycolmap.Rotation3d(rotation(np.random.default_rng(1)))
    found.transform(pycolmap.Sim3d(0.3, turn, np.array([5.0, -2.0, 7.0])))


@pytest.mark.parametrize("arc", [2 * np.pi, 1e-9])
def test_a_model_is_laid_onto_the_earlier_one(tmp_path: Path, arc: float) -> None:
    """Also if all photos are from one place, as good as."""
    earlier, later = model(tmp_path, arc=arc), model(tmp_path, arc=arc)
    elsewhere(later)
    assert not np.allclose(centres(later), centres(earlier), atol=0.1)
    assert worker._laid_onto(later, earlier)
    np.testing.assert_allclose(centres(later), centres(earlier), atol=1e-9)


def test_a_photo_that_moved_does_not_matter(tmp_path: Path) -> None:
    earlier, later = model(tmp_path), model(tmp_path)
    later.frames[3].rig_from_world = pycolmap.Rigid3d(
        pycolmap.Rotation3d(rotation(np.random.default_rng(2))), np.array([1.0, 2.0, 3.0])
    )
    elsewhere(later)
    assert worker._laid_onto(later, earlier)
    away = np.linalg.norm(centres(later) - centres(earlier), axis=1)
    assert sorted(away > 0.02) == [False] * 5 + [True]


def test_models_without_common_photos_are_not_laid(tmp_path: Path) -> None:
    earlier, later = model(tmp_path / "a"), model(tmp_path / "b", photos=2)
    for image in later.images.values():
        image.name = f"other-{image.name}"
    before = centres(later)
    assert not worker._laid_onto(later, earlier)
    np.testing.assert_array_equal(centres(later), before)


def test_the_database_must_be_that_of_the_model(tmp_path: Path) -> None:
    found, database = model(tmp_path), tmp_path / "database.db"
    with closing(sqlite3.connect(database)) as file:
        file.execute("CREATE TABLE images (image_id INTEGER, name TEXT)")
        file.execute("CREATE TABLE keypoints (image_id INTEGER, rows INTEGER)")
        for key, image in found.images.items():
            file.execute("INSERT INTO images VALUES (?, ?)", (key, image.name))
            file.execute("INSERT INTO keypoints VALUES (?, ?)", (key, len(image.points2D)))
        file.execute("INSERT INTO images VALUES (99, 'more.png')")
        file.commit()
        assert worker._is_of(found, database)
        file.execute("UPDATE keypoints SET rows = rows + 1 WHERE image_id = 1")
        file.commit()
        assert not worker._is_of(found, database)


def test_a_folder_that_begins_again_cannot_grow(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.work().mkdir()
    photos = [
        Photo(name=name, path=tmp_path / name, digest=name, size=(4, 3), device="", sharpness=1.0)
        for name in ("a", "b")
    ]
    assert folder.begin(photos, {}) == "" and not folder.can_grow
    model(tmp_path, photos=3)
    folder.finish("key")
    assert folder.can_grow and folder.finished_model == folder.model
    folder.database.touch()
    assert folder.begin(photos[:1], {}) and not folder.can_grow
    assert folder.finished_model == folder.model  # it says where the next one stands
    folder.finish("other")
    assert folder.can_grow and not read_record(folder.work("state.json"))["apart"]
