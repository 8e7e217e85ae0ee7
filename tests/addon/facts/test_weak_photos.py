"""Photos whose cameras hang on few points."""

from __future__ import annotations

import shutil
from types import ModuleType

import numpy as np
import pytest

from tests.addon.panels import said

pytestmark = pytest.mark.blender


def test_they_are_named_until_they_are_excluded(
    blender: ModuleType, run, tmp_path_factory: pytest.TempPathFactory
) -> None:
    from roigs_addon.facts import weak_photos
    from roigs_addon.ui.scene import ScenePanel

    scene, _ = run
    assert weak_photos.used(scene) == []
    assert not any("misplaced" in text for text in said(blender, ScenePanel))
    folder = tmp_path_factory.mktemp("weak") / "model"
    shutil.copytree(scene.roigs.model_cache, folder)
    starts = np.load(folder / "observed_starts.npy")
    starts[3:] -= starts[3] - starts[2] - 1  # the third photo observes one point
    np.save(folder / "observed_starts.npy", starts)
    scene.roigs.model_cache = str(folder)
    assert weak_photos.used(scene) == ["photo 2.png"]
    texts = said(blender, ScenePanel)
    assert any(text.startswith("Perhaps misplaced (fewer than 30") for text in texts)
    assert "Exclude 2" in texts or "Exclude photo 2" in texts
    blender.ops.roigs.exclude_photos(photo="photo 2.png")
    assert weak_photos.used(scene) == []
    assert not any("misplaced" in text for text in said(blender, ScenePanel))


def test_a_model_without_observations_tells_nothing(blender: ModuleType, run) -> None:
    from roigs_addon.facts import weak_photos

    run[0].roigs.model_cache = ""
    assert weak_photos.used(run[0]) == []
