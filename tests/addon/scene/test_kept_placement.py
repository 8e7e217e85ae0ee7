"""The placement of a scene in its project's folder: written, read by others, undone."""

from __future__ import annotations

import json
import shutil
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.scene_transform import FILE, read_transforms
from tests.addon.placement_cases import matrix
from tests.addon.scenes import add_box, command_line, imported, record

pytestmark = pytest.mark.blender


def test_another_file_gets_the_placement(blender: ModuleType, garden) -> None:
    from roigs_addon.scene import placement

    scene, folder = garden
    assert not placement.is_kept(scene)
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    blender.ops.roigs.set_floor(first=(0, 0, 1), second=(1, 0, 1.2), third=(0, 1, 1))
    mine = matrix(scene)
    assert placement.is_kept(scene)
    blender.ops.wm.read_factory_settings(use_empty=True)
    again = imported(blender, folder)
    np.testing.assert_allclose(matrix(again), mine, atol=1e-5)
    assert placement.is_kept(again)
    again.roigs.root.location.x += 0.5
    blender.context.view_layer.update()
    assert not placement.is_kept(again)
    blender.ops.roigs.keep_placement()
    assert placement.is_kept(again)


def test_a_root_that_was_moved_by_hand_stays(blender: ModuleType, garden) -> None:
    scene, folder = garden
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    scene.roigs.root.location = 1, 2, 3
    by_hand = matrix(scene)
    imported(blender, folder)
    np.testing.assert_array_equal(matrix(scene), by_hand)


def test_lengths_in_the_file_are_metres(blender: ModuleType, garden) -> None:
    scene, folder = garden
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.001
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=250)  # millimetres
    (kept,) = read_transforms(folder / FILE)
    np.testing.assert_allclose(kept.matrix[:3], matrix(scene)[:3] / 1000, rtol=1e-5, atol=1e-9)
    mine = matrix(scene)
    blender.ops.wm.read_factory_settings(use_empty=True)
    metres = np.diag([1e-3, 1e-3, 1e-3, 1]) @ mine
    np.testing.assert_allclose(matrix(imported(blender, folder)), metres, atol=1e-6)


def test_undo_and_redo_take_the_file_along(blender: ModuleType, garden) -> None:
    bpy, (_, folder) = blender, garden
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="imported")
    texts = [None]
    for length in (2.0, 5.0):
        bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=length)
        bpy.ops.ed.undo_push(message="placed")
        texts.append((folder / FILE).read_text())
    assert len(set(texts)) == 3
    for at in (1, 0):
        bpy.ops.ed.undo()
        text = (folder / FILE).read_text() if (folder / FILE).exists() else None
        assert text == texts[at]
    bpy.ops.ed.redo()
    assert (folder / FILE).read_text() == texts[1]


def test_a_placement_of_another_file_survives_undo(blender: ModuleType, garden) -> None:
    bpy, (_, folder) = blender, garden
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    others = (folder / FILE).read_text()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    from roigs_addon.scene import placement

    placement.unregister()  # as in a Blender that was started anew
    placement.register()
    imported(bpy, folder)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=7)
    bpy.ops.ed.undo_push(message="placed")
    assert (folder / FILE).read_text() != others
    bpy.ops.ed.undo()
    assert (folder / FILE).read_text() == others


@pytest.mark.parametrize("there", [False, True])
def test_undo_does_not_write_what_a_blend_brings(blender: ModuleType, garden, there: bool) -> None:
    """A .blend may be somebody else's, or older than the file."""
    bpy, (scene, folder) = blender, garden
    if there:
        (folder / FILE).write_text('{"placements": []}')
    bpy.context.preferences.edit.use_global_undo = True
    scene.roigs.placement = "of a stranger"
    bpy.ops.ed.undo_push(message="opened")
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=7)
    bpy.ops.ed.undo_push(message="placed")
    placed = (folder / FILE).read_text()
    bpy.ops.ed.undo()
    now = (folder / FILE).read_text() if (folder / FILE).exists() else None
    assert now == ('{"placements": []}' if there else None)
    bpy.ops.ed.redo()
    assert (folder / FILE).read_text() == placed


def test_a_folder_that_cannot_be_written(blender: ModuleType, garden, capfd) -> None:
    """The scene is placed all the same, and one line says so."""
    from roigs_addon.scene import placement

    scene, folder = garden
    before = matrix(scene)
    shutil.rmtree(folder)
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    assert not np.allclose(matrix(scene), before) and not folder.exists()
    assert "Saved in this .blend only" in capfd.readouterr().out
    assert not placement.is_kept(scene)
    folder.mkdir()
    (folder / FILE).write_text("{}")
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    assert (folder / FILE).read_text() == "{}", "what is no placement of ours stays"


def test_a_file_of_another_model_is_not_used(blender: ModuleType, garden, capfd) -> None:
    from roigs_addon.jobs import current

    scene, folder = garden
    upright = matrix(scene)
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    document = json.loads((folder / FILE).read_text())
    for name in document["placements"][0]["cameras"]:
        document["placements"][0]["cameras"][name][0] += 9
    (folder / FILE).write_text(json.dumps(document))
    blender.ops.wm.read_factory_settings(use_empty=True)
    np.testing.assert_allclose(matrix(imported(blender, folder)), upright, atol=1e-6)
    assert any("not of this model" in text for text in current.state().warnings)


def test_a_training_is_not_outdated_by_it(blender: ModuleType, garden, engine) -> None:
    """The engine's input is the same to the last digit."""
    from roigs_addon.scene import cameras, lookup, rois

    scene, folder = garden
    roi = add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    key, box = rois.place_key(roi, scene), record(roi, scene)
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=123)
    blender.ops.roigs.set_floor(first=(0, 0, 1), second=(1, 0.2, 1.2), third=(0, 1, 1))
    blender.ops.roigs.set_origin()
    assert rois.place_key(roi, scene) == key and record(roi, scene) == box
    for item in lookup.cameras(scene).values():
        assert cameras.photo_of(item, scene.roigs.root) == lookup.photo_record(item)
    out = folder / "out"
    command_line(engine, "export", folder, "--placed", "--out", out)
    exported = json.loads((out / "scene.json").read_text())["images"]
    for image in exported:
        pose = np.array(image["world_to_camera"])
        eye = lookup.cameras(scene)[image["name"]].matrix_world.translation
        np.testing.assert_allclose(-pose[:3, :3].T @ pose[:3, 3], eye, rtol=1e-4, atol=1e-3)


def test_the_undo_of_another_blend_leaves_the_file_alone(blender: ModuleType, garden) -> None:
    """A .blend of before the placement knows nothing of it; its steps do not take it back."""
    bpy, (_, folder) = blender, garden
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    kept = (folder / FILE).read_text()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = imported(bpy, folder)
    scene.roigs.placement = ""
    bpy.ops.ed.undo_push(message="opened")
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.ed.undo_push(message="cube")
    bpy.ops.ed.undo()
    assert (folder / FILE).read_text() == kept
    bpy.ops.ed.redo()
    assert (folder / FILE).read_text() == kept


def test_the_undo_of_another_scene_leaves_the_file_alone(blender: ModuleType, garden) -> None:
    from roigs_addon.scene import placement

    bpy, (scene, folder) = blender, garden
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    kept = (folder / FILE).read_text()
    other = bpy.data.scenes.new("other")
    other.roigs.colmap = scene.roigs.colmap
    placement._after_undo(other)
    assert (folder / FILE).read_text() == kept
