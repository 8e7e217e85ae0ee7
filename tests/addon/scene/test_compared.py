"""Two results in the same objects, and a run folder that becomes smaller."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import write_ply
from tests.addon.panels import Layout, stand_in
from tests.addon.results import choose, cut, files
from tests.addon.scenes import listed_stage
from tests.addon.splat_cases import random_arrays, random_ply

pytestmark = pytest.mark.blender


def test_a_and_b(blender: ModuleType, two) -> None:
    scene, folder, older = two
    item, back = scene.objects["thing Gaussians"], scene.objects["Background"]
    item.location = 1, 2, 3
    back.hide_set(True)
    back.hide_render = True
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    seen = {o.name: (o.visible_get(), o.hide_render) for o in scene.objects}
    for place in (older, folder, older):
        assert blender.ops.roigs.compare_results() == {"FINISHED"}
        assert {file.parents[0 if file.parent == place else 1] for file in files(scene)} == {place}
        assert {o.name: (o.visible_get(), o.hide_render) for o in scene.objects} == seen
        assert tuple(item.location) == (1, 2, 3)


def test_edits_wait_for_their_result(blender: ModuleType, two) -> None:
    item = two[0].objects["thing Gaussians"]
    count = len(item.data.vertices)
    blender.ops.roigs.select_gaussians(name=item.name)
    blender.ops.object.mode_set(mode="EDIT")
    blender.ops.mesh.select_all(action="DESELECT")
    blender.ops.object.mode_set(mode="OBJECT")
    item.data.vertices[0].select = True
    blender.ops.object.mode_set(mode="EDIT")
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    assert len(item.data.vertices) == count - 1
    for _ in range(2):
        blender.ops.roigs.compare_results()
        assert len(item.data.vertices) == count
        blender.ops.roigs.compare_results()
        assert len(item.data.vertices) == count - 1
    meshes = len(blender.data.meshes)
    blender.ops.roigs.compare_results()
    assert len(blender.data.meshes) == meshes + 1, "nothing is lost, and nothing piles up"


def count(item) -> int:
    return len(item.data.vertices)


def test_edits_come_back_to_linked_copies(blender: ModuleType, two) -> None:
    item = two[0].objects["Background"]
    every = count(item)
    blender.ops.roigs.select_gaussians(name=item.name)
    blender.ops.object.duplicate(linked=True)
    copy = blender.context.active_object
    cut(blender, item, range(2))
    for _ in range(2):
        blender.ops.roigs.compare_results()
        assert copy.data == item.data and count(item) == every
        blender.ops.roigs.compare_results()
        assert copy.data == item.data and count(item) == every - 2


def test_edited_copies_are_shown_with_their_result(blender: ModuleType, two) -> None:
    item = two[0].objects["Background"]
    every = count(item)
    blender.ops.roigs.select_gaussians(name=item.name)
    blender.ops.object.duplicate()
    copy = blender.context.active_object
    cut(blender, copy, range(10))
    for _ in range(2):
        blender.ops.roigs.compare_results()
        assert not copy.visible_get() and copy.hide_render and item.visible_get()
        blender.ops.roigs.compare_results()
        assert copy.visible_get() and not copy.hide_render and count(copy) == every - 10


def test_a_loaded_result_has_no_edits_of_before(blender: ModuleType, two) -> None:
    item = two[0].objects["Background"]
    every, meshes = count(item), len(blender.data.meshes)
    cut(blender, item, range(2))
    blender.ops.roigs.compare_results()
    blender.ops.roigs.load_results()
    assert len(blender.data.meshes) == meshes
    cut(blender, item, range(5))
    blender.ops.roigs.compare_results()
    blender.ops.roigs.compare_results()
    assert count(item) == every - 5


def test_a_click_on_an_earlier_result_keeps_edits_of_the_last(blender: ModuleType, two) -> None:
    item = two[0].objects["thing Gaussians"]
    every = count(item)
    cut(blender, item, range(7))
    blender.ops.roigs.load_results(earlier=two[2].name)
    assert count(item) == every
    blender.ops.roigs.compare_results()
    assert count(item) == every - 7


def test_edits_do_not_come_back_to_another_training(blender: ModuleType, two) -> None:
    scene, folder, _ = two
    item = scene.objects["Background"]
    cut(blender, item, range(2))
    blender.ops.roigs.compare_results()
    random_ply(folder / "background.ply", 77, seed=9)
    blender.ops.roigs.load_results()
    blender.ops.roigs.compare_results()
    blender.ops.roigs.compare_results()
    assert count(item) == 77


def test_comparing_ends_edit_mode_and_keeps_its_edits(blender: ModuleType, two) -> None:
    item = two[0].objects["Background"]
    every = count(item)
    blender.ops.roigs.select_gaussians(name=item.name)
    choose(blender, item, range(3))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.roigs.compare_results()
    assert item.mode == "OBJECT" and count(item) == every
    blender.ops.roigs.compare_results()
    assert count(item) == every - 3


@pytest.mark.parametrize("load", [True, False])
def test_of_a_damaged_result_nothing_is_shown(blender: ModuleType, two, load: bool) -> None:
    scene, _, older = two
    cut(blender, scene.objects["Background"], range(2))
    before = {o.name: count(o) for o in scene.objects if o.type == "MESH"}
    (older / "rois" / "thing.ply").write_bytes(b"ply")
    objects, meshes = len(blender.data.objects), len(blender.data.meshes)
    show = partial(blender.ops.roigs.load_results, earlier=older.name)
    with pytest.raises(RuntimeError, match=r"thing\.ply"):
        (show if load else blender.ops.roigs.compare_results)()
    assert {o.name: count(o) for o in scene.objects if o.type == "MESH"} == before
    assert all(older not in file.parents for file in files(scene))
    assert (len(blender.data.objects), len(blender.data.meshes)) == (objects, meshes)


@pytest.mark.parametrize("switch", ["load_results", "compare_results"])
def test_a_training_that_failed_at_once_renames_nothing(
    blender: ModuleType, two, switch: str
) -> None:
    from roigs_addon.scene import splats

    scene = two[0]
    item = scene.objects["thing Gaussians"]
    item.location = 1, 2, 3
    splats.rename_boxes(scene, {"thing": "pot"})
    assert item.name == "pot Gaussians"
    getattr(blender.ops.roigs, switch)()
    assert item.name == "thing Gaussians" and item.roigs.roi == "thing"
    assert tuple(item.location) == (1, 2, 3) and not item.roigs.parked


def test_a_box_of_one_result_comes_back(blender: ModuleType, two) -> None:
    from roigs_addon.facts import run_facts

    scene, _, older = two
    for part in ("rois", "coarse"):
        (older / part / "thing.ply").unlink()
        away = random_arrays(12, seed=3)
        write_ply(older / part / "other.ply", away | {"means": away["means"] + np.float32(9)})
    item = scene.objects["thing Gaussians"]
    item.location.x = 5
    for _ in range(2):
        blender.ops.roigs.compare_results()
        assert not item.visible_get() and item.hide_render
        assert scene.objects["other Gaussians"].visible_get()
        assert not scene.objects["other first pass"].visible_get()
        assert run_facts.lost_splats(scene) == []
        blender.ops.roigs.compare_results()
        assert item.visible_get() and not item.hide_render and item.location.x == 5
        assert not scene.objects["thing first pass"].visible_get()
        assert not scene.objects["other Gaussians"].visible_get()
    blender.ops.roigs.load_results()
    assert "other Gaussians" not in scene.objects


@pytest.mark.parametrize("load", [False, True])
def test_a_renamed_box_is_the_same_box(blender: ModuleType, two, load: bool) -> None:
    scene, _, older = two
    for part in ("rois", "coarse"):
        (older / part / "thing.ply").rename(older / part / "Box 1.ply")
    item, every = scene.objects["thing Gaussians"], len(scene.objects)
    item.location, item.roigs.exposure, item.roigs.tint = (1, 2, 3), 0.5, (1, 0.5, 1)
    cut(blender, item, range(4))
    left, meshes = count(item), 0
    seen = {o: (o.hide_get(), o.hide_render, o.hide_viewport) for o in scene.objects}
    for _ in range(5):
        if load:
            blender.ops.roigs.load_results(earlier=older.name)
        else:
            blender.ops.roigs.compare_results()
        assert item.name == "Box 1 Gaussians" and item.roigs.roi == "Box 1"
        assert Path(item.roigs.ply) == older / "rois" / "Box 1.ply" and count(item) == left + 4
        blender.ops.roigs.compare_results()
        assert item.name == "thing Gaussians" and count(item) == left
        assert {o: (o.hide_get(), o.hide_render, o.hide_viewport) for o in scene.objects} == seen
        assert tuple(item.location) == (1, 2, 3)
        assert item.roigs.exposure == 0.5 and tuple(item.roigs.tint) == (1, 0.5, 1)
        assert len(scene.objects) == every
        assert meshes in (0, len(blender.data.meshes))
        meshes = len(blender.data.meshes)


def test_a_box_elsewhere_is_another_box() -> None:
    from roigs_addon.geometry.overlap import overlap

    points = random_arrays(500, seed=1)["means"]
    assert overlap(points, random_arrays(900, seed=2)["means"]) > 0.8
    assert overlap(points, points + np.float32([1.5, 0, 0])) < 0.3
    assert overlap(points, points[:0]) == overlap(points[:1], points[:1]) == 0


def test_the_earlier_result_that_was_shown_last(blender: ModuleType, two) -> None:
    from roigs_addon.scene import compared

    scene, folder, older = two
    newer = folder / "earlier" / "00000000"
    shutil.copytree(older, newer)
    blender.ops.roigs.load_results(earlier=older.name)
    blender.ops.roigs.compare_results()
    assert compared.shown_result(scene) == folder
    blender.ops.roigs.compare_results()
    assert compared.shown_result(scene) == older


def test_the_button_stays_under_the_mouse(blender: ModuleType, two) -> None:
    from roigs_addon.ui.result import ResultPanel

    class Row(Layout):
        """Notes what is drawn, in order; buttons by their operators."""

        def __getattr__(self, name: str):
            def take(*args: object, **_: object) -> Row:
                self.labels.append(str(args[0]) if name == "operator" else name)
                return Row(self.labels)

            return take

    for part in ("rois", "coarse"):
        (two[2] / part / "thing.ply").unlink()
    above = []
    for _ in range(2):
        panel = stand_in(ResultPanel)
        panel.layout = Row([])
        panel.draw(blender.context)
        drawn = panel.layout.labels
        above.append(drawn[: drawn.index("roigs.compare_results")])
        blender.ops.roigs.compare_results()
    assert above[0] == above[1]


def test_without_another_result_there_is_no_compare(blender: ModuleType, run) -> None:
    assert not blender.ops.roigs.compare_results.poll()
    blender.ops.roigs.load_results()
    assert not blender.ops.roigs.compare_results.poll()


def test_clean_up(blender: ModuleType, two) -> None:
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    _, folder, older = two
    assert not blender.ops.roigs.clean_up.poll()
    (folder / "manifest.json").write_text('{"config": {}}')
    listed_stage(folder, "scene")
    gone = ("preview.ply", "stages/scene-1234abcd/model.ply", f"cache/undistorted/{1:032x}.png")
    for path in (Path(folder, name) for name in gone):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(1_000_000))
    kept = {path for path in folder.rglob("*") if path.is_file()} - {folder / g for g in gone}
    assert "Clean Up (3 MB of " in " ".join(said(blender, ResultPanel))
    assert blender.ops.roigs.clean_up() == {"FINISHED"}
    assert {path for path in folder.rglob("*") if path.is_file()} == kept
    assert older.is_dir() and "Clean Up (0 of " in " ".join(said(blender, ResultPanel))
