"""Small pictures of photos. In background mode Blender gives them no icons."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.panels import stand_in
from tests.addon.scenes import imported

pytestmark = pytest.mark.blender


def loaded() -> list[str]:
    """Names of the files whose pictures are kept."""
    from roigs_addon.facts import photo_pictures

    return [Path(path).name for path in photo_pictures._pictures or ()]


def test_pictures_are_loaded_when_asked_for(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.facts import caches, photo_pictures

    scene = imported(blender, project)
    assert loaded() == []
    for name in ("photo 1.png", "photo 2.png", "photo 1.png", "none.png"):
        photo_pictures.icon(scene, name)
    assert loaded() == ["photo 1.png", "photo 2.png"]
    caches.forget()
    assert loaded() == []


def test_few_pictures_are_kept(
    blender: ModuleType, addon: ModuleType, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.facts import photo_pictures

    scene = imported(blender, project)
    monkeypatch.setattr(photo_pictures, "MOST", 3)
    for number in range(8):
        photo_pictures.icon(scene, f"photo {number}.png")
        assert len(loaded()) <= 3 and f"photo {number}.png" in loaded()


def test_a_photo_without_a_file(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    from roigs_addon.facts import photo_pictures
    from roigs_addon.scene import lookup

    scene = imported(blender, project)
    camera = lookup.cameras(scene)["photo 1.png"]
    camera.roigs.photo = json.dumps({**json.loads(camera.roigs.photo), "path": ""})
    assert photo_pictures.icon(scene, "photo 1.png") == 0 and loaded() == []


def test_the_panel_shows_the_photo_that_is_active_in_the_list(
    blender: ModuleType, addon: ModuleType, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.facts import photo_pictures
    from roigs_addon.ui.selected import SelectedPanel

    bpy, scene, shown = blender, imported(blender, project), []
    numbers = {"photo 3.png": 33, "photo 4.png": 44}
    monkeypatch.setattr(photo_pictures, "icon", lambda _, photo: numbers[photo])

    class Recorder:
        def __getattr__(self, name: str):
            def take(*_: object, **keywords: object) -> Recorder:
                if name == "template_icon":
                    shown.append(keywords["icon_value"])
                return self

            return take

        def __setattr__(self, name: str, value: object) -> None:
            pass

    bpy.ops.roigs.add_roi()
    for name in numbers:
        bpy.ops.roigs.edit_selection(action="ADD", photo=name)
    panel = stand_in(SelectedPanel)
    panel.layout = Recorder()
    panel.draw(bpy.context)
    scene.roigs.active_roi.roigs.selection_index = 1
    panel.draw(bpy.context)
    assert shown == [33, 44]
