"""Boxes in Blender: where they come from, what is written for the engine."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.boxes import add_roi, cube
from tests.addon.roots import new_root

pytestmark = pytest.mark.blender


def written(scene, folder: Path) -> np.ndarray:
    """All numbers of the boxes in rois.json."""
    from roigs_addon.scene import lookup, rois

    record = json.loads(rois.write(folder, lookup.rois(scene), scene).read_text("utf-8"))
    return np.array(
        [[*np.ravel(roi["world_to_box"]), *roi["half_extents"]] for roi in record["rois"]]
    )


# --- adding ---


@pytest.mark.parametrize("kind", ["none", "plain", "turned and scaled"])
def test_at_the_cursor(blender: ModuleType, addon: ModuleType, kind: str) -> None:
    from roigs_addon.scene import lookup

    scene = blender.context.scene
    root = None if kind == "none" else new_root(blender, kind)
    scene.cursor.location = 1, 2, 3
    roi = add_roi(blender)
    assert (roi.type, roi.empty_display_type, roi.parent) == ("EMPTY", "CUBE", root)
    np.testing.assert_allclose(roi.matrix_world.translation, (1, 2, 3), atol=1e-5)
    assert lookup.rois(scene) == [roi] and roi.select_get()
    box = lookup.box(roi, scene)
    np.testing.assert_allclose(box.half_extents[0], box.half_extents, rtol=0.7)
    if "scaled" not in kind:
        np.testing.assert_allclose(box.half_extents, 1.0)


@pytest.mark.parametrize("kind", ["none", "plain", "turned and scaled"])
def test_around_selected_objects(blender: ModuleType, addon: ModuleType, kind: str) -> None:
    from roigs_addon.scene import lookup

    scene = blender.context.scene
    root = None if kind == "none" else new_root(blender, kind)
    item = cube(blender)
    item.select_set(True)
    roi = add_roi(blender)
    assert roi != item and not item.select_get()
    corners = np.array([item.matrix_world @ v.co for v in item.data.vertices])
    to_root = np.linalg.inv(lookup.matrix_world(root))
    box = lookup.box(roi, scene)
    assert box.contains((corners @ to_root[:3, :3].T + to_root[:3, 3]).astype(np.float32)).all()
    if kind != "turned and scaled":
        np.testing.assert_allclose(box.half_extents, np.array([0.5, 1, 2]) * 1.05, rtol=1e-5)


def test_new_boxes_are_upright_and_tight(blender: ModuleType, addon: ModuleType) -> None:
    """Also below a root that is turned, as most models need."""
    from mathutils import Matrix, Quaternion

    from roigs_addon.scene import lookup

    bpy, scene = blender, blender.context.scene
    root = new_root(bpy, "plain")
    turn = Quaternion((0.5, 0.5, -0.5, 0.5)) @ Quaternion((1, 1, 0), 0.5)
    root.matrix_world = Matrix.LocRotScale((5, -2, 1), turn, (2, 2, 2))
    bpy.context.view_layer.update()
    cube(bpy).select_set(True)
    roi = add_roi(bpy)
    sides = np.array([0.5, 1, 2]) * 1.05
    upright = np.diag([*sides, 1.0])
    upright[:3, 3] = 1, 2, 3
    np.testing.assert_allclose(lookup.matrix_world(roi), upright, atol=1e-5)
    np.testing.assert_allclose(roi.rotation_euler, 0, atol=1e-6)
    np.testing.assert_allclose(lookup.box(roi, scene).half_extents, sides / 2, rtol=1e-5)
    before = lookup.box(roi, scene).world_to_box
    bpy.ops.object.rotation_clear()  # Alt-R
    root.location.x += 1
    bpy.context.view_layer.update()
    np.testing.assert_allclose(lookup.matrix_world(roi)[:3, 3], (2, 2, 3), atol=1e-5)
    np.testing.assert_array_equal(lookup.box(roi, scene).world_to_box, before)


def test_around_vertices_selected_in_edit_mode(blender: ModuleType, addon: ModuleType) -> None:
    scene = blender.context.scene
    item = cube(blender)
    for vertex in item.data.vertices:
        vertex.select = vertex.co.z > 0
    blender.ops.object.mode_set(mode="EDIT")
    roi = add_roi(blender)
    assert blender.context.mode == "OBJECT" and roi in list(scene.objects)
    np.testing.assert_allclose(roi.matrix_world.translation, (1, 2, 5), atol=1e-5)
    # A flat selection gets some depth.
    np.testing.assert_allclose(roi.scale, np.array([0.5, 1, 0.05]) * 1.05, rtol=1e-5)


def test_names_are_free_ones(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.scene import lookup

    scene = blender.context.scene
    names = [add_roi(blender).name for _ in range(3)]
    assert names == ["Box 1", "Box 2", "Box 3"]
    copy = scene.objects["Box 1"].copy()
    scene.collection.objects.link(copy)
    assert [roi.name for roi in lookup.rois(scene)] == ["Box 1", "Box 1.001", "Box 2", "Box 3"]


def test_the_active_box(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, blender.context.scene

    def active() -> str:
        return lookup.active_roi(bpy.context).name

    for _ in range(3):
        add_roi(bpy)
    assert active() == "Box 3"
    bpy.ops.roigs.select_roi(name="Box 1")
    assert active() == "Box 1" == bpy.context.active_object.name
    scene.objects["Box 1"].name = "vase"  # comes last in the list now, and stays active
    assert active() == "vase"
    bpy.ops.roigs.remove_roi()
    assert active() == "Box 3" and "vase" not in bpy.data.objects
    bpy.data.objects.remove(scene.objects["Box 3"])  # by Blender's own means
    assert active() == "Box 2"
    bpy.ops.roigs.remove_roi()
    assert lookup.active_roi(bpy.context) is None
    assert not bpy.ops.roigs.remove_roi.poll()
    with pytest.raises(RuntimeError, match="There is no box 'vase'"):
        bpy.ops.roigs.select_roi(name="vase")


def test_the_name_of_a_deleted_box_is_free(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """Blender's own delete only removes it from the scene: the panel's list still points to it."""
    from roigs_addon.scene import lookup

    bpy, scene = blender, blender.context.scene
    corners = {"min": [0, 0, 0], "max": [1, 1, 1]}
    path = tmp_path / "rois.json"
    path.write_text(json.dumps({"rois": [{"name": name, **corners} for name in "ab"]}))
    for _ in range(2):
        bpy.ops.roigs.load_rois(filepath=str(path))
        assert [roi.name for roi in lookup.rois(scene)] == ["a", "b"]
        for name in "ab":
            bpy.ops.roigs.select_roi(name=name)
            bpy.ops.object.delete()
        assert "b" in bpy.data.objects and not lookup.rois(scene)
    roi = add_roi(bpy)
    assert "b" not in bpy.data.objects and scene.roigs.active_roi == roi
    bpy.ops.object.delete()
    assert add_roi(bpy).name == "Box 1"


def test_all_boxes_are_added_or_none(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, blender.context.scene
    roi = add_roi(bpy)
    corners = {"min": [0, 0, 0], "max": [1, 1, 1]}
    path = tmp_path / "rois.json"
    path.write_text(json.dumps({"rois": [{"name": n, **corners} for n in ("a", "Box 1", "b")]}))
    with pytest.raises(RuntimeError, match="name 'Box 1' is taken"):
        bpy.ops.roigs.load_rois(filepath=str(path))
    assert lookup.rois(scene) == list(bpy.data.objects) == [roi]
    assert scene.roigs.active_roi == roi


def test_boxes_in_an_excluded_collection(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, blender.context.scene
    root = new_root(bpy, "plain")
    home = bpy.data.collections.new("home")
    scene.collection.children.link(home)
    scene.collection.objects.unlink(root)
    home.objects.link(root)
    first = add_roi(bpy)
    assert home.objects.get(first.name) == first
    bpy.context.view_layer.layer_collection.children["home"].exclude = True
    second = add_roi(bpy)
    assert second.parent == root and second.select_get()
    assert scene.collection.objects.get(second.name) == second
    bpy.ops.roigs.select_roi(name=first.name)
    assert lookup.active_roi(bpy.context) == first and not second.select_get()


# --- what is written ---


@pytest.mark.parametrize("parented", [True, False])
def test_moving_root_and_boxes_together_changes_nothing(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, parented: bool
) -> None:
    from mathutils import Euler, Matrix

    bpy, scene = blender, blender.context.scene
    root = new_root(bpy, "turned")
    for number in range(3):
        roi = add_roi(bpy)
        world = Matrix.LocRotScale(
            (number, -1.0, 0.5), Euler((0.3, number, 1.0)), (0.5, 1.0 + number, 0.2)
        )
        if not parented:
            roi.parent = None
        roi.matrix_world = world
        roi.empty_display_size = 0.5 + number
    bpy.context.view_layer.update()
    before = written(scene, tmp_path)
    change = Matrix.LocRotScale((4.0, 5.0, -6.0), Euler((1.0, 2.0, 3.0)), (3.3, 3.3, 3.3))
    for item in [root] if parented else [root, *(o for o in scene.objects if o != root)]:
        item.matrix_world = change @ item.matrix_world
    bpy.context.view_layer.update()
    if parented:
        np.testing.assert_array_equal(written(scene, tmp_path), before)
    else:
        np.testing.assert_allclose(written(scene, tmp_path), before, atol=1e-6, rtol=1e-6)


def test_what_the_engine_reads(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    """The engine reads the file, and its boxes are where the empties are."""
    from roigs_engine.model.roi import load_rois

    scene = blender.context.scene
    new_root(blender, "turned and scaled")
    scene.cursor.location = 1, 2, 3
    add_roi(blender).scale = 0.5, -1.0, 2.0
    blender.context.view_layer.update()
    numbers = written(scene, tmp_path)[0]
    (roi,) = load_rois(tmp_path / "rois.json")
    assert roi.name == "Box 1"
    np.testing.assert_allclose(roi.world_to_box.ravel(), numbers[:16], atol=1e-6)
    np.testing.assert_allclose(roi.half_extents, numbers[16:])


@pytest.mark.parametrize(
    "name", ["a/b", "a\\b", "c:", "who?", "(*)", "...", 'a"', "<", "|", "NUL", "com1.x"]
)
def test_names_that_cannot_name_files(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, name: str
) -> None:
    from roigs_addon.errors import AddonError

    add_roi(blender).name = name
    with pytest.raises(AddonError, match="cannot name a file"):
        written(blender.context.scene, tmp_path)


def test_names_that_differ_in_case_only(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError

    add_roi(blender).name = "vase"
    add_roi(blender).name = "VASE"
    with pytest.raises(AddonError, match=r"Two boxes are named 'vase' .*Rename one"):
        written(blender.context.scene, tmp_path)


def test_a_file_that_does_not_exist(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"There is no file .*none\.json"):
        blender.ops.roigs.load_rois(filepath=str(tmp_path / "none.json"))


def test_flat_and_slanted_boxes_are_refused(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.facts import point_counts

    scene = blender.context.scene
    root = new_root(blender, "plain")
    roi = add_roi(blender)
    roi.scale.z = 0
    blender.context.view_layer.update()
    with pytest.raises(AddonError, match="'Box 1' has no volume"):
        written(scene, tmp_path)
    assert point_counts.count(roi, scene) is None
    roi.scale.z = 1
    roi.rotation_euler.z = 0.5
    root.scale.x = 2
    blender.context.view_layer.update()
    written(scene, tmp_path)  # slanted in the world, but a box to COLMAP
    roi.parent = None
    blender.context.view_layer.update()
    with pytest.raises(AddonError, match="'Box 1' is slanted"):
        written(scene, tmp_path)
    root.scale = 0, 0, 0
    blender.context.view_layer.update()
    with pytest.raises(AddonError, match="no volume"):
        written(scene, tmp_path)
