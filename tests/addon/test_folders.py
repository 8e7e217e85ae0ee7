"""Where things are kept: what outlives the extension, whose run a folder holds."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


def test_runs_of_unsaved_files_outlive_the_extension(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import preferences, requests

    extension = tmp_path / ".user" / "roigs"
    monkeypatch.setattr(preferences, "ADDON", "bl_ext.user_default.roigs")
    monkeypatch.setattr(blender.utils, "extension_path_user", lambda _: str(extension))
    run = requests.run_folder(blender.context.scene)
    assert not run.is_relative_to(extension)
    assert run.is_relative_to(blender.utils.user_resource("DATAFILES"))
    assert preferences.environments().is_relative_to(extension)
    assert preferences.models_folder().is_relative_to(extension)
    assert not extension.exists()
