"""First folders of file browsers."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import imported

pytestmark = pytest.mark.blender

BOXES = '{"rois": [{"name": "a", "min": [0, 0, 0], "max": [1, 1, 1]}]}'


@pytest.fixture(autouse=True)
def own_data_folder(addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from roigs_addon import settings

    monkeypatch.setattr(settings, "data_folder", lambda: tmp_path / "user")


def folder(path: Path) -> str:
    return os.path.join(path, "")


@pytest.mark.parametrize("chosen", [".", "sparse", "sparse/0", "images"])
def test_import_starts_beside_the_last_project(
    blender: ModuleType, project: Path, chosen: str
) -> None:
    from roigs_addon.operators import folders

    assert folders.for_import("") == ""
    imported(blender, project / chosen)
    assert folders.for_import("") == folder(project.parent)


def test_before_the_first_import_it_starts_beside_the_blend(
    blender: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.operators import folders

    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert folders.for_import("") == folders.for_boxes("") == folder(tmp_path)


def test_boxes_start_in_the_project_or_where_its_boxes_were(
    blender: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.operators import folders

    colmap = str(project / "sparse")
    imported(blender, project / "sparse")
    assert folders.for_boxes(colmap) == folder(project)
    other = tmp_path / "boxes"
    other.mkdir()
    (other / "rois.json").write_text(BOXES)
    blender.ops.roigs.load_rois(filepath=str(other / "rois.json"))
    assert folders.for_boxes(colmap) == folder(other)
    assert folders.for_boxes(str(tmp_path)) == folder(tmp_path)  # of another project
    assert folders.for_boxes("") == folder(other)


def test_folders_that_are_gone_and_damaged_notes(blender: ModuleType, tmp_path: Path) -> None:
    from roigs_addon.operators import folders

    folders.imported(tmp_path / "gone" / "garden")
    assert folders.for_import("") == ""
    (tmp_path / "user" / "folders.json").write_text("[")
    assert folders.for_import(str(tmp_path / "garden")) == folder(tmp_path)
    folders.imported(tmp_path / "garden")
    assert folders.for_import("") == folder(tmp_path)


def test_where_nothing_can_be_written_nothing_is_remembered(
    blender: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.operators import folders

    (tmp_path / "user").touch()
    folders.imported(tmp_path / "garden")
    assert folders.for_import("") == ""
