"""Refined models: where they are, and whether they are still valid."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from roigs_engine.colmap.project import find_model
from roigs_engine.formats import projects
from roigs_engine.formats.projects import IMAGES_FILES, PHOTO_FOLDERS, REFINED_FILES, refined_folder


def model(folder: Path, seconds: float) -> Path:
    """A folder with the files of a model, last changed then."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in REFINED_FILES:
        (folder / name).touch()
        os.utime(folder / name, (seconds, seconds))
    return folder


@pytest.mark.parametrize(
    ("imported", "refined"),
    [
        ("garden", "garden/sparse/refined"),
        ("garden/sparse", "garden/sparse/refined"),
        ("garden/sparse/0", "garden/sparse/refined"),
        ("garden/sparse/refined", "garden/sparse/refined"),
        ("garden/sparse/1", "garden/sparse/refined-1"),
        ("garden/sparse/refined-1", "garden/sparse/refined-1"),
        ("garden/images", "garden/sparse/refined"),
        ("garden/images_8", "garden/sparse/refined"),
        ("garden/images of mine", "garden/images of mine/refined"),
        ("flat", "flat/refined"),
        ("flat/images", "flat/refined"),
    ],
)
def test_every_model_has_a_folder_of_its_own(tmp_path: Path, imported: str, refined: str) -> None:
    for name in ("garden/sparse/0", "garden/sparse/1", "flat"):
        model(tmp_path / name, 1000)
    for name in ("garden/images", "garden/images_8", "garden/images of mine", "flat/images"):
        (tmp_path / name).mkdir()
    assert refined_folder(tmp_path / imported) == tmp_path / refined


@pytest.mark.parametrize("photos", PHOTO_FOLDERS)
@pytest.mark.parametrize("place", ["", "sparse", "sparse/0", "0"])
def test_photos_stand_for_the_project_that_the_engine_loads(
    tmp_path: Path, photos: str, place: str
) -> None:
    made = model(tmp_path / place, 1000)
    (tmp_path / photos).mkdir()
    assert find_model(tmp_path / photos) == made
    assert refined_folder(tmp_path / photos) == refined_folder(tmp_path)


def test_a_project_below_a_folder_called_sparse(tmp_path: Path) -> None:
    project = tmp_path / "sparse" / "0"
    (project / "sparse" / "0").mkdir(parents=True)
    assert refined_folder(project) == project / "sparse" / "refined"


def test_a_model_is_complete_with_all_its_files(tmp_path: Path) -> None:
    assert not projects.is_refined_model(tmp_path / "none")
    folder = model(tmp_path / "refined", 1000)
    assert projects.is_refined_model(folder)
    (folder / "points3D.bin").unlink()
    assert not projects.is_refined_model(folder)


@pytest.mark.parametrize("source", ["sparse/0", "sparse"])
def test_a_newer_model_makes_it_outdated(tmp_path: Path, source: str) -> None:
    made_from = model(tmp_path / source, 1000)
    folder = model(tmp_path / "sparse" / "refined", 2000)
    assert not projects.is_outdated(folder)
    model(tmp_path / "sparse" / "other", 3000)  # no model that the engine would take by itself
    assert not projects.is_outdated(folder)
    os.utime(made_from / IMAGES_FILES[0], (3000, 3000))
    assert projects.is_outdated(folder)
