"""Gaussians as Blender's own splats, as the add-on draws them, and as points."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.testing import assert_allclose

from roigs_engine.formats.splat_ply import read_ply
from tests.addon.levels_cases import make_levels
from tests.addon.panels import said
from tests.addon.scenes import drawn_points, seen_from_afar
from tests.addon.splat_cases import recoloured

pytestmark = pytest.mark.blender

FINE, COARSE = "thing Gaussians", "thing first pass"


@pytest.fixture
def scene(blender: ModuleType, run):
    """A scene with a result."""
    blender.ops.roigs.load_results()
    return run[0]


@pytest.fixture
def native(scene):
    """The same, where Blender has splats of its own."""
    from roigs_addon.scene import native_splats

    if not native_splats.exist():
        pytest.skip("this Blender has no splats of its own")
    return scene


def splats(bpy: ModuleType) -> dict[str, int]:
    """Objects that Blender shows as its own splats -> how many."""
    bpy.context.view_layer.update()
    found = drawn_points(bpy).items()
    return {name: facts["points"] for name, facts in found if facts["type"] == "GAUSSIAN_SPLAT"}


def shown(bpy: ModuleType, item) -> dict[str, np.ndarray]:
    """The attributes of an object as Blender shows it."""
    from roigs_addon.scene.splat_attributes import sh_of, values

    depsgraph = bpy.context.evaluated_depsgraph_get()
    geometry = item.evaluated_get(depsgraph).evaluated_geometry()
    data = geometry.pointcloud
    names = ("position", "scale", "rotation", "radiance:base")
    return {name: values(data, name) for name in names} | {"sh": sh_of(data)}


def test_older_blenders_show_them_by_the_add_on(blender: ModuleType, scene) -> None:
    """The exact look is then the only one, whatever a file of a newer Blender says."""
    from roigs_addon.scene import compositor, display, lookup, native_splats
    from roigs_addon.viewport.objects import marked

    if native_splats.exist():
        pytest.skip("this Blender has splats of its own")
    for way in ("GAUSSIANS", "EXACT"):
        blender.ops.roigs.show_as(way=way)
        assert display.in_layer(scene) == lookup.splats(scene) and compositor.find(scene)
        assert len([item for item in marked(scene.objects) if item.visible]) == 2
        assert not drawn_points(blender)


def test_results_are_blenders_own_splats(blender: ModuleType, native) -> None:
    """One object for each box and one for the background, of the file's Gaussians."""
    from roigs_addon.scene import compositor, display
    from roigs_addon.scene.frame_request import frame_request
    from roigs_addon.viewport.objects import marked

    assert splats(blender) == {"Background": 41, FINE: 42}
    assert compositor.find(native) is None and not display.in_layer(native)
    assert marked(native.objects) == []
    depsgraph = blender.context.evaluated_depsgraph_get()
    assert frame_request(native, depsgraph, "out") is None
    item = native.objects[FINE]
    arrays, found = read_ply(item.roigs.ply), shown(blender, item)
    frame = np.array(item.data["roigs_frame"]).reshape(4, 4)
    assert_allclose(found["position"], arrays["means"] + frame[:3, 3], atol=1e-5)
    assert_allclose(found["scale"], np.exp(arrays["log_scales"]), rtol=1e-5)
    assert_allclose(found["sh"], arrays["sh"], atol=1e-6)
    opacities = 1 / (1 + np.exp(-arrays["logit_opacities"]))
    assert_allclose(found["radiance:base"][:, 3], opacities, atol=1e-6)


def test_cycles_shows_them(blender: ModuleType, native, tmp_path: Path) -> None:
    """And where they are moved, without the engine."""
    before = seen_from_afar(blender, native, tmp_path / "before.png")[..., 3]
    assert before.max() > 0.3
    for item in native.objects:
        if item.roigs.kind == "SPLATS":
            item.hide_render = True
    assert seen_from_afar(blender, native, tmp_path / "after.png")[..., 3].max() == 0


def test_the_first_pass_of_a_box(blender: ModuleType, native) -> None:
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    assert splats(blender) == {"Background": 41, COARSE: 43}
    blender.ops.roigs.set_detail(roi="thing", fine=True)
    assert splats(blender) == {"Background": 41, FINE: 42}


def test_another_result_is_blenders_splats(blender: ModuleType, native, two) -> None:
    """Compare shows the earlier result's Gaussians, and Load Results the last one's again."""
    item, found = native.objects[FINE], {}
    for result in ("last", "earlier", "last again"):
        file = read_ply(item.roigs.ply)["sh"]
        found[result] = shown(blender, item)["sh"]
        assert_allclose(found[result], file, atol=1e-6)
        blender.ops.roigs.compare_results()
    assert not np.allclose(found["last"], found["earlier"])
    assert np.array_equal(found["last"], found["last again"])
    assert splats(blender) == {"Background": 41, FINE: 42}


def test_an_instance_is_counted_once(blender: ModuleType, native) -> None:
    """An export would have its Gaussians twice: of the mesh, and of the splats made of it."""
    from roigs_addon.scene import instances

    collection = blender.data.collections.new("vases")
    collection.objects.link(native.objects[FINE])
    empty = blender.data.objects.new("vases", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    native.collection.objects.link(empty)
    found = instances.instances(blender.context.evaluated_depsgraph_get())
    assert [(each.item.name, each.instancer) for each in found] == [(FINE, empty)]


def test_deleted_gaussians_are_gone(blender: ModuleType, native) -> None:
    """From what Blender shows at once; undo brings them back, and an export has the same."""
    from roigs_addon.scene import edits, point_edits

    blender.ops.ed.undo_push(message="before")
    item = native.objects[FINE]
    point_edits.remove(item, np.arange(42) < 10)
    assert splats(blender)[FINE] == 32
    edits.look_again(item)
    assert len(read_ply(edits.file_of(item))["means"]) == 32
    blender.ops.ed.undo_push(message="deleted")
    blender.ops.ed.undo()
    assert splats(blender)[FINE] == 42


def test_levels_of_detail_are_of_the_exact_look(blender: ModuleType, native, run) -> None:
    """Blender draws all of its splats; the panel says so, and offers no levels."""
    from roigs_addon.scene import ladders
    from roigs_addon.ui.levels import LevelsPanel
    from roigs_addon.ui.result import ResultPanel

    make_levels(run[1], rate=1.0)
    item = native.objects[FINE]
    assert ladders.of(item, native) is None
    assert "Auto" not in said(blender, ResultPanel)
    assert any("Blender draws all" in text for text in said(blender, LevelsPanel))
    blender.ops.roigs.show_as(way="EXACT")
    assert ladders.of(item, native) is not None
    assert not any("Blender draws all" in text for text in said(blender, LevelsPanel))


def test_the_look_is_in_the_colours(blender: ModuleType, native) -> None:
    """Also of a copy, of an animated look, and of the other object of its pair."""
    item = native.objects[FINE]
    sh = shown(blender, item)["sh"]
    item.roigs.exposure, item.roigs.tint = 1.0, (1.0, 0.5, 0.25)
    blender.context.view_layer.update()
    found, gains = shown(blender, item), np.array((2.0, 1.0, 0.5))
    assert_allclose(found["sh"], recoloured(sh, gains), atol=1e-5)
    assert found["radiance:base"].shape == (42, 4)
    copy = item.copy()
    native.collection.objects.link(copy)
    copy.roigs.exposure, copy.roigs.tint = 0.0, (1.0, 1.0, 1.0)
    copy.roigs.keyframe_insert("exposure", frame=1)
    copy.roigs.exposure = -1.0
    copy.roigs.keyframe_insert("exposure", frame=11)
    native.frame_set(11)
    blender.context.view_layer.update()
    assert_allclose(shown(blender, copy)["sh"], recoloured(sh, np.full(3, 0.5)), atol=1e-5)
    assert_allclose(shown(blender, item)["sh"], recoloured(sh, gains), atol=1e-5)


def test_the_exact_look(blender: ModuleType, native) -> None:
    """The add-on draws them, renders get the engine's layer, and new objects follow."""
    from roigs_addon.scene import compositor, lookup
    from roigs_addon.viewport.objects import marked

    item = native.objects[FINE]
    assert len(item.animation_data.drivers) == 4
    blender.ops.roigs.show_as(way="EXACT")
    assert not splats(blender) and compositor.find(native)
    assert not len(item.animation_data.drivers)  # Blender would warn of them
    assert len([item for item in marked(native.objects) if item.visible]) == 2
    blender.data.objects.remove(native.objects[FINE])
    blender.ops.roigs.load_results()
    assert {item.roigs.shown_as for item in lookup.splats(native)} == {"EXACT"}
    assert not splats(blender)
    blender.ops.roigs.show_as(way="POINTS")
    assert {facts["type"] for facts in drawn_points(blender).values()} == {"POINTS"}
    blender.ops.roigs.show_as(way="GAUSSIANS")
    assert splats(blender) == {"Background": 41, FINE: 42} and marked(native.objects) == []


def test_the_add_on_draws_them_in_edit_mode(blender: ModuleType, native) -> None:
    """Blender has no splats there; points that were deleted in it are gone after it."""
    from roigs_addon.viewport.objects import marked

    item = native.objects[FINE]
    blender.context.view_layer.objects.active = item
    blender.ops.object.mode_set(mode="EDIT")
    assert [found.visible for found in marked([item])] == [True]
    blender.ops.mesh.select_all(action="SELECT")
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    assert marked([item]) == [] and splats(blender).get(FINE, 0) == 0


def test_a_preview_is_drawn_by_the_add_on(blender: ModuleType, native, run) -> None:
    """It is a file that changes while it trains; the result is back after it."""
    from roigs_addon.scene import splats as results
    from roigs_addon.viewport.objects import marked

    results.show_preview(native, run[1] / "result.ply")
    assert len(marked(native.objects)) == 1 and not splats(blender)
    blender.ops.roigs.load_results()
    assert splats(blender) == {"Background": 41, FINE: 42} and not marked(native.objects)


def test_files_of_other_blenders(
    blender: ModuleType, native, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that was saved where there were no splats shows them, and the other way round."""
    from roigs_addon.scene import native_splats
    from roigs_addon.viewport.objects import marked

    path = str(tmp_path / "saved.blend")
    with monkeypatch.context() as patch:
        patch.setattr(native_splats, "exist", lambda: False)
        blender.ops.roigs.load_results()
        blender.ops.roigs.show_as(way="GAUSSIANS")
        assert not splats(blender)
        blender.ops.wm.save_as_mainfile(filepath=path)
    blender.ops.wm.open_mainfile(filepath=path)
    assert splats(blender) == {"Background": 41, FINE: 42}
    blender.ops.wm.save_as_mainfile(filepath=path)
    with monkeypatch.context() as patch:
        patch.setattr(native_splats, "exist", lambda: False)
        blender.ops.wm.open_mainfile(filepath=path)
        assert not splats(blender)
        assert len([item for item in marked(blender.data.objects) if item.visible]) == 2


@pytest.mark.parametrize("scale", [(1.5, 1.5, 1.5), (1.0, 0.5, 1.2)], ids=["even", "uneven"])
def test_apply_keeps_the_picture(blender: ModuleType, native, tmp_path: Path, scale) -> None:
    """Shapes and view-dependent colours turn with the points."""
    from roigs_addon.scene import edits

    item = native.objects[FINE]
    native.objects["Background"].hide_render = True
    item.rotation_euler, item.scale = (0.7, 0.4, 1.1), scale
    before = seen_from_afar(blender, native, tmp_path / "before.png", samples=64)
    item.select_set(True)
    blender.context.view_layer.objects.active = item
    blender.ops.object.transform_apply(location=False, rotation=True, scale=True)
    blender.context.view_layer.update()
    after = seen_from_afar(blender, native, tmp_path / "after.png", samples=64)
    assert np.allclose(item.matrix_world.to_scale(), 1) and before[..., 3].max() > 0.3
    assert np.abs(after - before).mean() < 0.2 * before.mean()
    assert not list(Path(blender.app.tempdir).glob(f"{edits.PREFIX}*")), "nothing reads such a file"
    blender.ops.roigs.load_results()
    blender.context.view_layer.update()
    again = seen_from_afar(blender, native, tmp_path / "again.png", samples=64)
    assert np.abs(again - before).mean() < 0.2 * before.mean()
