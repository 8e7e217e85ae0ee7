"""Excluded photos: how they are marked, what the engine is told, and how they come back."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.panels import said
from tests.addon.scenes import imported, options, ready

pytestmark = pytest.mark.blender


def told(scene, folder: Path, what: str = "train") -> list[str]:
    """The photos that the engine is told to leave out."""
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    if what == "train":
        options_files.write_train_options(scene, lookup.rois(scene), 0.0)
    else:
        options_files.write_select_options(scene, lookup.rois(scene))
    excluded: list[str] = options(folder, what).get("exclude", [])
    return excluded


def test_the_engine_is_told_and_the_panels_say(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup
    from roigs_addon.scene.selections import EXCLUDED_COLOUR
    from roigs_addon.ui.cameras import CamerasPanel
    from roigs_addon.ui.scene import ScenePanel

    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    bpy.ops.roigs.exclude_photos(photo="photo 3.png")
    for name in ("photo 1.png", "photo 6.png"):
        lookup.cameras(scene)[name].select_set(True)
    bpy.ops.roigs.exclude_photos()
    names = ["photo 1.png", "photo 3.png", "photo 6.png"]
    assert told(scene, tmp_path / "run") == told(scene, tmp_path / "run", "select") == names
    for panel in (ScenePanel, CamerasPanel):
        assert "3 photos excluded" in said(bpy, panel)
    camera = lookup.cameras(scene)["photo 3.png"]
    assert tuple(camera.color) == pytest.approx(EXCLUDED_COLOUR)
    bpy.ops.roigs.include_photos()  # those that are selected
    assert told(scene, tmp_path / "run") == ["photo 3.png"]
    bpy.ops.roigs.include_photos(photo="photo 3.png")
    assert told(scene, tmp_path / "run") == [] and tuple(camera.color) == (1, 1, 1, 1)


def test_cameras_are_found_whatever_they_are_called(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.scene import lookup

    scene = imported(blender, project)
    every = lookup.cameras(scene)
    every["photo 1.png"].name = "mine"
    every["photo 2.png"].name, every["photo 3.png"].name = "other", "photo 2.png"
    photos = {"photo 1.png", "photo 2.png", "photo 5.png", "gone.png"}
    found = lookup.named_cameras(scene, photos)
    assert set(found) == {every[f"photo {number}.png"] for number in (1, 2, 5)}


def test_the_panel_counts_what_is_excluded_now(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    """Also in a copied scene, and after as many others were excluded."""
    from roigs_addon.facts import photo_names

    bpy, scene = blender, imported(blender, project)
    bpy.ops.roigs.exclude_photos(photo="photo 3.png")
    assert photo_names.excluded(scene) == ["photo 3.png"]
    bpy.ops.roigs.include_photos(photo="photo 3.png")
    bpy.ops.roigs.exclude_photos(photo="photo 4.png")
    assert photo_names.excluded(scene) == ["photo 4.png"]
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    copy.roigs.excluded[0].name = "photo 5.png"
    assert photo_names.excluded(copy) == ["photo 5.png"]
    assert photo_names.excluded(scene) == ["photo 4.png"]


def test_hidden_cameras_are_used(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    cameras = lookup.cameras(scene)
    cameras["photo 0.png"].hide_set(True)
    cameras["photo 1.png"].hide_viewport = True
    assert told(scene, tmp_path / "run") == []


def test_boxes_keep_excluded_photos_but_are_not_trained_on_them(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    import json

    from roigs_addon.scene import lookup

    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    (roi,) = lookup.rois(scene)
    for number in (2, 5):
        bpy.ops.roigs.edit_selection(action="ADD", photo=f"photo {number}.png")
    bpy.ops.roigs.exclude_photos(photo="photo 2.png")
    told(scene, tmp_path / "run")
    given = tmp_path / "run" / "blender" / "selection" / "thing.json"
    assert json.loads(given.read_text("utf-8"))["names"] == ["photo 5.png"]
    bpy.ops.roigs.exclude_photos(photo="photo 5.png")
    told(scene, tmp_path / "run")
    assert "selection" not in options(tmp_path / "run", "train")  # the engine selects
    bpy.ops.roigs.include_photos(every=True)
    told(scene, tmp_path / "run")
    assert json.loads(given.read_text("utf-8"))["names"] == ["photo 2.png", "photo 5.png"]
    assert [item.name for item in roi.roigs.selection] == ["photo 2.png", "photo 5.png"]


def test_they_stay_excluded(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """After saving, undo of something else, and importing the same model again."""
    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    bpy.ops.roigs.exclude_photos(photo="photo 4.png")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert told(bpy.context.scene, tmp_path / "run") == ["photo 4.png"]
    scene = imported(bpy, project)
    assert told(scene, tmp_path / "run") == ["photo 4.png"]


def test_undo_includes_again(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    from roigs_addon.facts import photo_names

    bpy, scene = blender, imported(blender, project)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.roigs.exclude_photos(photo="photo 4.png")
    bpy.ops.ed.undo_push(message="Exclude Photos")
    assert len(photo_names.excluded(scene)) == 1
    bpy.ops.ed.undo()
    assert not photo_names.excluded(bpy.context.scene)
    bpy.ops.ed.redo()
    assert len(photo_names.excluded(bpy.context.scene)) == 1


def test_another_model_has_other_photos(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from tests.addon.colmap_project import write_project

    bpy, scene = blender, imported(blender, project)
    bpy.ops.roigs.exclude_photos(photo="photo 4.png")
    other = write_project(tmp_path / "other", 6)  # photos of the same names, elsewhere
    imported(bpy, other)
    assert len(scene.roigs.excluded) == 0


def test_deleted_cameras_come_back_where_they_were(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, imported(blender, project)
    scene.roigs.root.location.x = 5
    bpy.context.view_layer.update()
    before = lookup.matrix_world(lookup.cameras(scene)["photo 2.png"])
    record = lookup.cameras(scene)["photo 2.png"].roigs.photo
    bpy.data.objects.remove(lookup.cameras(scene)["photo 2.png"])
    bpy.ops.roigs.include_photos(every=True)
    bpy.context.view_layer.update()
    camera = lookup.cameras(scene)["photo 2.png"]
    np.testing.assert_allclose(lookup.matrix_world(camera), before, atol=1e-6)
    assert camera.roigs.photo == record
    assert camera.users_collection == lookup.cameras(scene)["photo 0.png"].users_collection


def test_what_cannot_be_excluded_is_said(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    imported(blender, project)
    with pytest.raises(RuntimeError, match="There is no photo 'none'"):
        blender.ops.roigs.exclude_photos(photo="none")
    blender.ops.object.select_all(action="DESELECT")
    with pytest.raises(RuntimeError, match="Select cameras first"):
        blender.ops.roigs.exclude_photos()
