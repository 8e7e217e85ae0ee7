"""Fixtures of the tests of scenes."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.colmap_project import write_project
from tests.addon.scenes import imported


@pytest.fixture
def garden(blender: ModuleType, addon: ModuleType, tmp_path: Path):
    """A project of its own, imported."""
    folder = write_project(tmp_path / "garden")
    return imported(blender, folder), folder
