"""Trained Gaussians in Blender: objects, attributes, renders."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.run_files import BACKGROUND
from tests.addon.pictures import read_png
from tests.addon.scenes import drawn_points, imported, with_cycles
from tests.addon.splat_cases import random_arrays, random_ply

pytestmark = pytest.mark.blender

SH_C0 = 0.28209479177387814


def levels(scene) -> dict[str, object]:
    from roigs_addon.scene import lookup

    return {item.roigs.level: item for item in lookup.splats(scene)}


def values(mesh, name: str) -> np.ndarray:
    """(N, ...) of an attribute."""
    from roigs_addon.scene.clouds import ATTRIBUTE_KEYS

    attribute = mesh.attributes[name]
    width = {"FLOAT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "QUATERNION": 4}[attribute.data_type]
    flat = np.empty(width * len(attribute.data), np.float32)
    attribute.data.foreach_get(ATTRIBUTE_KEYS[attribute.data_type], flat)
    return flat.reshape(-1, width).squeeze()


def test_results_are_objects_below_the_root(blender: ModuleType, run) -> None:
    scene, folder = run
    assert blender.ops.roigs.load_results() == {"FINISHED"}
    found = levels(scene)
    assert set(found) == {"RESULT", "ROI", "SCENE"}
    assert all(item.parent == scene.roigs.root for item in found.values())
    assert [len(found[level].data.vertices) for level in ("RESULT", "ROI", "SCENE")] == [41, 42, 43]
    assert found["ROI"].roigs.roi == "thing" == found["SCENE"].roigs.roi
    assert Path(found["RESULT"].roigs.ply) == folder / BACKGROUND
    assert found["ROI"].visible_get() and found["RESULT"].visible_get()
    assert not found["SCENE"].visible_get() and found["SCENE"].hide_render


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_attributes(blender: ModuleType, run, coefficients: int) -> None:
    scene, folder = run
    random_ply(folder / "rois" / "thing.ply", 30, seed=9, coefficients=coefficients)
    arrays = random_arrays(30, seed=9, coefficients=coefficients)
    blender.ops.roigs.load_results()
    item = levels(scene)["ROI"]
    mesh = item.data
    from roigs_addon.scene.clouds import positions

    np.testing.assert_allclose(positions(item) + item.location, arrays["means"], atol=1e-6)
    np.testing.assert_allclose(values(mesh, "scale"), np.exp(arrays["log_scales"]), rtol=1e-5)
    opacity = 1 / (1 + np.exp(-arrays["logit_opacities"]))
    np.testing.assert_allclose(values(mesh, "opacity"), opacity, rtol=1e-5)
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    np.testing.assert_allclose(values(mesh, "rotation"), quats, atol=1e-6)
    radiance = values(mesh, "radiance:base")
    np.testing.assert_array_equal(radiance[:, :3], arrays["sh"][:, 0])
    np.testing.assert_allclose(radiance[:, 3], opacity, rtol=1e-5)
    for index, name in enumerate((f"radiance:sh_{i}" for i in range(coefficients - 1)), start=1):
        np.testing.assert_array_equal(values(mesh, name), arrays["sh"][:, index])
    assert f"radiance:sh_{coefficients - 1}" not in mesh.attributes
    srgb = np.clip(0.5 + SH_C0 * arrays["sh"][:, 0], 0, 1)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(values(mesh, "Color")[:, :3], linear, atol=1e-5)


@pytest.mark.exact_look
def test_points_and_gaussians(blender: ModuleType, run) -> None:
    """As points the objects have geometry in the viewport; as Gaussians they have none."""
    scene, _ = run
    blender.ops.roigs.load_results()
    item = levels(scene)["RESULT"]
    assert item.name not in drawn_points(blender)
    blender.ops.roigs.show_as(way="POINTS")
    drawn = drawn_points(blender)[item.name]
    assert drawn["points"] == 41 and drawn["radius"] > 0 and "opacity" in drawn["attributes"]
    assert item.roigs.shown_as == "POINTS"
    blender.ops.roigs.show_as(way="GAUSSIANS")
    assert item.name not in drawn_points(blender)
    assert item.roigs.shown_as == "GAUSSIANS"


def test_coarse_and_fine(blender: ModuleType, run) -> None:
    from roigs_addon.scene import detail

    scene, _ = run
    blender.ops.roigs.load_results()
    for fine in (False, True):
        blender.ops.roigs.set_detail(roi="thing", fine=fine)
        found = levels(scene)
        assert found["ROI"].visible_get() == fine != found["SCENE"].visible_get()
        assert found["ROI"].hide_render != fine
        (pair,) = detail.pairs(scene)
        assert pair.shown == found["ROI" if fine else "SCENE"]
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    blender.ops.roigs.load_results()  # something of the box is seen in any case
    found = levels(scene)
    assert found["ROI"].visible_get() and not found["ROI"].hide_render
    assert not found["SCENE"].visible_get() and found["SCENE"].hide_render


def test_gaussians_are_selected_by_name(blender: ModuleType, run) -> None:
    bpy, (scene, _) = blender, run
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.select_roi(name="thing")
    item = levels(scene)["ROI"]
    bpy.ops.roigs.select_gaussians(name=item.name)
    assert bpy.context.active_object == item and bpy.context.selected_objects == [item]
    with pytest.raises(RuntimeError, match="no Gaussians 'thing'"):
        bpy.ops.roigs.select_gaussians(name="thing")


def test_new_results_replace_old_ones(blender: ModuleType, run) -> None:
    bpy, (scene, folder) = blender, run
    bpy.ops.roigs.load_results()
    item = levels(scene)["ROI"]
    item.name, item.location.x = "mine", 3.0
    before = len(bpy.data.meshes), len(bpy.data.objects), len(bpy.data.node_groups)
    random_ply(folder / "rois" / "thing.ply", 77, seed=5)
    bpy.ops.roigs.load_results()
    assert levels(scene)["ROI"] == item
    assert (item.name, item.location.x, len(item.data.vertices)) == ("mine", 3.0, 77)
    assert (len(bpy.data.meshes), len(bpy.data.objects), len(bpy.data.node_groups)) == before
    (folder / "rois" / "thing.ply").write_bytes(b"ply\n")
    with pytest.raises(RuntimeError, match=r"thing\.ply"):
        bpy.ops.roigs.load_results()


def test_results_that_are_gone_are_removed(blender: ModuleType, run) -> None:
    scene, folder = run
    blender.ops.roigs.load_results()
    others = [item for item in levels(scene).values() if item.roigs.level != "RESULT"]
    data = [item.data for item in others]
    assert len(data) == 2
    random_ply(folder / "rois" / "other.ply", 7, seed=1)
    earlier = folder / "earlier"
    earlier.mkdir()
    for name in ("rois", "coarse"):
        (folder / name / "thing.ply").rename(earlier / f"{name}.ply")
    names = [mesh.name for mesh in data]
    blender.ops.roigs.load_results()
    assert {item.roigs.roi for item in levels(scene).values()} == {"", "other"}
    assert not any(name in blender.data.meshes for name in names)


def test_previews_come_and_go(blender: ModuleType, run) -> None:
    from roigs_addon.scene import splats

    scene, folder = run
    blender.ops.roigs.load_results()
    preview = splats.show_preview(scene, folder / "result.ply")
    assert splats.show_preview(scene, folder / "result.ply") == preview
    found = levels(scene)
    assert not found["ROI"].visible_get() and not found["RESULT"].visible_get()
    assert preview.visible_get()
    assert preview.parent == scene.roigs.root
    blender.ops.roigs.load_results()
    found = levels(scene)
    assert "PREVIEW" not in found
    assert found["ROI"].visible_get() and not found["SCENE"].visible_get()
    # In a scene that no window shows.
    other = blender.data.scenes.new("other")
    splats.show_preview(other, folder / "result.ply")
    splats.show_results(other, folder)
    assert len(levels(other)) == 3


def test_cycles_shows_them(blender: ModuleType, run, tmp_path: Path) -> None:
    bpy, (scene, _) = blender, run
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.look_through(photo="photo 0.png")
    render = with_cycles(scene, samples=8)
    render.resolution_x = render.resolution_y = 64
    render.filepath = str(tmp_path / "cycles.png")
    bpy.ops.render.render(write_still=True)
    picture = read_png(tmp_path / "cycles.png").astype(float)
    assert (picture.max(axis=2) > 40).mean() > 0.01
    assert picture.std(axis=2).max() > 10  # colours


@pytest.mark.parametrize("nested", [False, True])
def test_each_scene_has_one_collection_of_gaussians(blender: ModuleType, run, nested: bool) -> None:
    from roigs_addon.scene import splats

    scene, folder = run
    blender.ops.roigs.load_results()
    other = blender.data.scenes.new("other")
    splats.show_imported(other, folder / "result.ply", "vase", in_model=True)
    if nested:  # the user sorts collections
        (collection,) = other.collection.children
        above = blender.data.collections.new("all")
        other.collection.children.link(above)
        above.children.link(collection)
        other.collection.children.unlink(collection)
        collection.name = "mine"
    splats.show_results(other, folder)
    for each in (scene, other):
        (used,) = {c for o in each.objects if o.roigs.kind == "SPLATS" for c in o.users_collection}
        assert used in list(each.collection.children_recursive)
    assert sum("ROI-GS" in c.name for c in blender.data.collections) == 2 - nested


def test_the_collection_of_an_earlier_version_is_used(blender: ModuleType, run) -> None:
    scene, folder = run
    blender.ops.roigs.load_results()
    (collection,) = (c for c in scene.collection.children if c.name == "ROI-GS Gaussians")
    for key in list(collection.keys()):
        del collection[key]
    random_ply(folder / "rois" / "other.ply", 7, seed=1)
    blender.ops.roigs.load_results()
    assert scene.objects["other Gaussians"].users_collection == (collection,)


def test_nothing_to_load(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    imported(blender, project)
    assert not blender.ops.roigs.load_results.poll()
