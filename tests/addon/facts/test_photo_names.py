"""How the panel names photos."""

from __future__ import annotations

from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


def test_photos_are_shown_without_folders_where_that_is_clear(
    blender: ModuleType, addon: ModuleType
) -> None:
    from roigs_addon.facts.photo_names import shortened

    names = ["a/1.jpg", "b/1.jpg", "b/deep/2.png", "3.jpg"]
    assert list(shortened(names).values()) == ["a/1.jpg", "b/1.jpg", "2", "3"]
