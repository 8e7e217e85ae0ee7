"""Alt-H keeps objects hidden that the add-on hides; each copy has its own Result and First Pass."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pytestmark = pytest.mark.blender


def alt_h(scene) -> None:
    """Open all eyes, as Alt-H does."""
    for item in scene.objects:
        item.hide_set(False)


def visible(scene) -> set[str]:
    """Names of the Gaussians that the viewport shows."""
    return {o.name for o in scene.objects if o.roigs.kind == "SPLATS" and o.visible_get()}


def look(bpy: ModuleType, scene) -> dict[str, tuple[bool, bool]]:
    return {o.name: (o.visible_get(), o.hide_render) for o in scene.objects}


@pytest.mark.parametrize("state", ["loaded", "coarse", "parked", "preview"])
def test_alt_h_shows_nothing_that_the_addon_hides(blender: ModuleType, two, state: str) -> None:
    from roigs_addon.scene import lookup, splats

    scene, folder, older = two
    if state == "coarse":
        blender.ops.roigs.set_detail(roi="thing", fine=False)
    elif state == "parked":
        for part in ("rois", "coarse"):
            (older / part / "thing.ply").unlink()
        blender.ops.roigs.compare_results()
    elif state == "preview":
        splats.show_preview(scene, folder / "result.ply")
    before = look(blender, scene)
    assert not lookup.points(scene).visible_get()
    alt_h(scene)
    assert look(blender, scene) == before


def test_what_the_user_hides_is_shown_by_alt_h_only(blender: ModuleType, two) -> None:
    scene, folder, _ = two
    item = scene.objects["thing Gaussians"]
    item.hide_set(True)
    blender.ops.roigs.compare_results()
    blender.ops.roigs.compare_results()
    blender.ops.wm.save_as_mainfile(filepath=str(folder / "h.blend"))
    blender.ops.wm.open_mainfile(filepath=str(folder / "h.blend"))
    scene = blender.context.scene
    assert visible(scene) == {"Background"}
    alt_h(scene)
    assert visible(scene) == {"Background", "thing Gaussians"}


def as_before(scene, *hidden: str) -> None:
    """Hide what the version before hid, as it did."""
    for item in scene.objects:
        if item.roigs.kind in ("SPLATS", "POINTS"):
            item.roigs.off = item.hide_viewport = item.hide_render = False
            if item.name in hidden or item.roigs.kind == "POINTS":
                item.hide_set(True)
                item.hide_render = True


@pytest.mark.parametrize("shown", ["Gaussians", "first pass"])
def test_files_of_the_version_before(blender: ModuleType, two, shown: str) -> None:
    from roigs_addon.scene import lookup

    scene, folder, _ = two
    other = {"Gaussians": "first pass", "first pass": "Gaussians"}[shown]
    as_before(scene, f"thing {other}")
    path = folder / "before.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    blender.ops.wm.open_mainfile(filepath=str(path))
    scene = blender.context.scene
    alt_h(scene)
    assert visible(scene) == {"Background", f"thing {shown}"}
    assert not lookup.points(scene).visible_get()
    blender.ops.roigs.set_detail(roi="thing", fine=shown == "first pass")
    assert visible(scene) == {"Background", f"thing {other}"}


def test_what_was_parked_by_the_version_before(blender: ModuleType, two) -> None:
    scene, folder, older = two
    for part in ("rois", "coarse"):
        (older / part / "thing.ply").unlink()
    blender.ops.roigs.compare_results()
    as_before(scene, "thing Gaussians", "thing first pass")
    scene.objects["thing Gaussians"].roigs.parked = "parked view render"
    scene.objects["thing first pass"].roigs.parked = "parked"
    path = folder / "before.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    blender.ops.wm.open_mainfile(filepath=str(path))
    scene = blender.context.scene
    blender.ops.roigs.compare_results()
    alt_h(scene)
    assert visible(scene) == {"Background", "thing Gaussians"}
    assert not scene.objects["thing Gaussians"].hide_render


def reopened(bpy: ModuleType, path: Path):
    """The scene, saved and opened again."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.context.scene


def test_what_the_user_hides_stays_hidden_if_saved_in_training(blender: ModuleType, two) -> None:
    from roigs_addon.scene import splats

    scene, folder, _ = two
    imported = splats.show_imported(scene, folder / "result.ply", "vase", in_model=True)
    imported.hide_set(True)
    scene.objects["thing Gaussians"].hide_set(True)
    splats.show_preview(scene, folder / "result.ply")
    scene = reopened(blender, folder / "h.blend")
    splats.remove_preview(scene)
    assert visible(scene) == {"Background"}
    alt_h(scene)
    assert visible(scene) == {"Background", "thing Gaussians", "vase"}


def test_what_the_version_before_hid_in_training_comes_back(blender: ModuleType, two) -> None:
    from roigs_addon.scene import splats

    scene, folder, _ = two
    splats.show_preview(scene, folder / "result.ply")
    scene.roigs.property_unset("result_mark")
    for item in scene.objects:
        item.roigs.property_unset("result_mark")
        if item.roigs.waits:
            item.roigs.waits = item.hide_viewport = False
            item.hide_set(True)
    scene = reopened(blender, folder / "before.blend")
    assert len(visible(scene)) == 1
    alt_h(scene)
    assert len(visible(scene)) == 1
    splats.remove_preview(scene)
    assert visible(scene) == {"Background", "thing Gaussians"}


@pytest.mark.parametrize("linked", [True, False])
def test_copies(blender: ModuleType, two, linked: bool) -> None:
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    bpy, (scene, _, _) = blender, two
    bpy.ops.roigs.select_gaussians(name="thing Gaussians")
    bpy.ops.object.duplicate(linked=linked)
    copy = bpy.context.active_object
    copy.location = 3, 2, 1
    copy.roigs.exposure = 1.0
    assert {"thing", copy.name} <= set(said(bpy, ResultPanel))
    bpy.ops.roigs.set_detail(name=copy.name, fine=False)
    bpy.context.view_layer.update()
    (stand_in,) = visible(scene) - {"Background", "thing Gaussians"}
    stand_in = scene.objects[stand_in]
    assert bpy.context.active_object == stand_in and stand_in.select_get()
    assert stand_in.roigs.level == "SCENE" and stand_in.roigs.exposure == 1.0
    frames = [np.array(o.matrix_world) @ frame_of(o) for o in (copy, stand_in)]
    np.testing.assert_allclose(*frames, atol=1e-5)
    assert not stand_in.hide_render and copy.hide_render
    stand_in.location.x += 1
    bpy.ops.roigs.set_detail(name="thing Gaussians", fine=False)
    bpy.ops.roigs.set_detail(name=stand_in.name, fine=True)
    assert visible(scene) == {"Background", "thing first pass", copy.name}
    assert copy.location.x == pytest.approx(4)
    every = len(scene.objects)
    for fine in (False, True):
        bpy.ops.roigs.set_detail(roi="thing", fine=fine)
        assert len(visible(scene)) == 3
    bpy.ops.roigs.load_results()
    assert len(scene.objects) == every
    assert visible(scene) == {"Background", "thing Gaussians", copy.name}


def frame_of(item) -> np.ndarray:
    from roigs_addon.scene import edits

    return edits.frame_of(item)


def test_without_a_coarse_model_the_fine_one_stays(blender: ModuleType, two) -> None:
    scene, folder, _ = two
    (folder / "coarse" / "thing.ply").unlink()
    blender.ops.roigs.load_results()
    with pytest.raises(RuntimeError, match="no first-pass model of 'thing'"):
        blender.ops.roigs.set_detail(roi="thing", fine=False)
    assert visible(scene) == {"Background", "thing Gaussians"}


def test_a_hidden_object_without_parent_is_placed_too(blender: ModuleType, two) -> None:
    from roigs_addon.scene import placement

    item = two[0].objects["thing first pass"]
    item.parent = None
    before = tuple(item.location)
    move = np.eye(4)
    move[:3, 3] = 1, 2, 3
    placement.move(two[0], move)
    np.testing.assert_allclose(item.location, np.add(before, (1, 2, 3)), atol=1e-5)


def test_the_sparse_points_have_a_switch(blender: ModuleType, two) -> None:
    from roigs_addon.ui.scene import ScenePanel
    from tests.addon.panels import said

    assert Path(two[1]).is_dir() and "Sparse points" in said(blender, ScenePanel)
