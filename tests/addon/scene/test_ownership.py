"""A scene's own results leave alone what came by Append, Link or Take Object."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.addon.results import set_aside
from tests.addon.scenes import ready
from tests.addon.splat_cases import random_ply
from tests.addon.surface_cases import write_ball

pytestmark = pytest.mark.blender

Bring = Callable[..., tuple[Any, Path, list[Any]]]


def write_result(folder: Path, box: str, first: int) -> None:
    """Files of a result, the numbers of whose Gaussians begin at `first`."""
    for number, name in enumerate(("result", "background", f"rois/{box}", f"coarse/{box}")):
        path = folder / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        random_ply(path, first + number, seed=first + number)


@pytest.fixture
def bring(blender: ModuleType, run, project: Path, tmp_path: Path) -> Bring:
    """A function that brings one file's objects into another one, which has its own results."""
    from roigs_addon.scene import box_surfaces

    scene, folder = run
    blender.ops.roigs.load_results()
    write_ball(folder / "rois" / "thing.glb", radius=0.15)
    item = box_surfaces.show(scene, "thing", folder / "rois" / "thing.glb")
    blender.ops.roigs.take_object(name=item.name)
    source = tmp_path / "a.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(source))

    def bring(way: str, *, box: str = "thing", shown: bool = True):
        blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        own = tmp_path / "own"
        for first in (200, 100):  # the last one is the newest
            write_result(own, box, first)
            if first == 200:
                set_aside(own)
        scene = ready(blender, project, own)
        blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b.blend"))
        if shown:
            blender.ops.roigs.load_results()
        before = set(scene.objects)
        if way == "take":
            blender.ops.wm.append(directory=f"{source}/Collection/", files=[{"name": "thing"}])
        else:
            names = ("Background", "thing Gaussians", "thing first pass", "thing Mesh")
            files = [{"name": name} for name in names]
            load = blender.ops.wm.append if way == "append" else blender.ops.wm.link
            load(directory=f"{source}/Object/", files=files)
        if way == "override":
            for item in [i for i in scene.objects if i.library is not None and i.type == "MESH"]:
                item.override_create(remap_local_usages=True)
        blender.context.view_layer.update()
        return scene, own, [i for i in scene.objects if i not in before and i.type == "MESH"]

    return bring


def state(items: list[Any]) -> list[object]:
    """What must not change of objects."""
    names = ("ply", "roi", "level", "kind", "shown_as", "parked", "waits", "off")
    return [
        (
            *(item.name, item.data, len(item.data.vertices), tuple(item.matrix_world.translation)),
            *(item.visible_get(), item.hide_viewport, item.hide_render),
            *(getattr(item.roigs, name) for name in names),
        )
        for item in items
    ]


def use_own_results(bpy: ModuleType, scene, own: Path, box: str) -> None:
    """All that shows results of the scene's own training."""
    from roigs_addon.scene import box_surfaces, splats

    bpy.ops.roigs.load_results()
    splats.show_preview(scene, own / "result.ply")
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.compare_results()
    bpy.ops.roigs.compare_results()
    splats.rename_boxes(scene, {box: "new"})
    splats.rename_boxes(scene, {"new": box})
    write_ball(own / "rois" / f"{box}.glb", radius=0.1)
    bpy.ops.roigs.load_results()
    write_ball(own / "rois" / f"{box}.glb", radius=0.2)
    box_surfaces.show(scene, box, own / "rois" / f"{box}.glb")


@pytest.mark.parametrize("shown", [True, False])
@pytest.mark.parametrize("box", ["thing", "other"])
@pytest.mark.parametrize("way", ["append", "take", "link", "override"])
def test_own_results_leave_others_alone(
    blender: ModuleType, bring: Bring, way: str, box: str, shown: bool
) -> None:
    from roigs_addon.scene import box_surfaces, compared, ownership

    scene, own, others = bring(way, box=box, shown=shown)
    assert len(others) >= 2
    before = state(others)
    use_own_results(blender, scene, own, box)
    assert state(others) == before
    assert compared.shown_result(scene) == own
    mine = {item.roigs.level: item for item in ownership.own_splats(scene)}
    assert {level: len(item.data.vertices) for level, item in mine.items()} == {
        "RESULT": 101,
        "ROI": 102,
        "SCENE": 103,
    }
    mesh = box_surfaces.surface_of(scene, box)
    assert mesh not in others and box_surfaces.gaussians_of(scene, mesh) == mine["ROI"]


@pytest.mark.parametrize("way", ["link", "override"])
def test_what_belongs_to_another_file_is_never_written(
    blender: ModuleType, bring: Bring, way: str
) -> None:
    """Blender does not save such changes, or a part of them."""
    from mathutils import Matrix

    from roigs_addon.scene import ownership, placement, splats

    scene, own, others = bring(way)
    before = state(others)
    for shown in ("POINTS", "EXACT", "GAUSSIANS", "POINTS"):
        blender.ops.roigs.show_as(way=shown)
        assert state(others) == before
    write_ball(own / "rois" / "thing.glb")
    blender.ops.roigs.load_results()
    (mine,) = (i for i in scene.objects if i.roigs.kind == "SURFACE" and i not in others)
    blender.ops.roigs.show_alone(name=mine.name)
    assert state(others) == before and mine.visible_get()
    assert not any(item.visible_get() for item in ownership.own_splats(scene))
    blender.ops.roigs.show_alone(name=mine.name)
    blender.ops.roigs.set_detail(name=ownership.own_splats(scene)[1].name, fine=False)
    assert state(others) == before
    placement.move(scene, np.array(Matrix.Translation((1, 2, 3))))
    blender.context.view_layer.update()
    assert state(others) == before
    (own.parent / "run").rename(own.parent / "away")
    splats.follow(scene, own.parent / "away")
    assert state(others) == before


def test_a_copy_of_the_file_may_bring_its_own_objects(blender: ModuleType, bring: Bring) -> None:
    """Both files come from one; the later one has trained again."""
    scene, own, _ = bring("append")
    saved = own.parent / "c.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(saved), copy=True)
    there = set(scene.objects)
    blender.ops.wm.append(directory=f"{saved}/Object/", files=[{"name": "thing Gaussians"}])
    blender.context.view_layer.update()
    (copy,) = (i for i in scene.objects if i not in there and i.type == "MESH")
    before = state([copy])
    write_result(own, "thing", 300)
    blender.ops.roigs.load_results()
    assert state([copy]) == before
    assert len(scene.objects["thing Gaussians"].data.vertices) == 302


def test_own_objects_use_nothing_of_a_linked_file(blender: ModuleType, bring: Bring) -> None:
    """It may be gone the next time."""
    from roigs_addon.scene import ownership

    scene, _, _ = bring("link", shown=False)
    blender.ops.roigs.load_results()
    for item in ownership.own_splats(scene):
        groups = [m.node_group for m in item.modifiers if m.type == "NODES" and m.node_group]
        nodes = [node for group in groups for node in group.nodes]
        inputs = [s.default_value for n in nodes for s in n.inputs if s.type == "MATERIAL"]
        used = [*groups, *filter(None, inputs)]
        assert len(used) > len(groups) and not any(each.library for each in used)


def test_an_appended_scene_keeps_its_results(blender: ModuleType, bring: Bring) -> None:
    from roigs_addon.scene import splats

    _, own, _ = bring("append")
    blender.ops.wm.append(directory=f"{own.parent / 'a.blend'}/Scene/", files=[{"name": "Scene"}])
    (scene,) = (each for each in blender.data.scenes if each != blender.context.scene)
    names = {item.name for item in scene.objects}
    write_result(own.parent / "run", "thing", 300)
    splats.show_results(scene, own.parent / "run")
    assert {item.name for item in scene.objects} == names
    counts = {len(i.data.vertices) for i in scene.objects if i.roigs.kind == "SPLATS"}
    assert counts == {301, 302, 303}


def test_what_was_taken_is_shown_as_gaussians_or_mesh(blender: ModuleType, bring: Bring) -> None:
    from roigs_addon.scene import box_surfaces

    scene, _, others = bring("take")
    mesh, cloud = sorted(others, key=lambda item: item.roigs.kind, reverse=True)
    for way, seen in (("GAUSSIANS", (False, True)), ("MESH", (True, False))):
        blender.ops.roigs.show_surface(name=mesh.name, way=way)
        assert (not mesh.hide_render, not cloud.hide_render) == seen
        assert not scene.objects["thing Gaussians"].hide_render
    assert len(box_surfaces.surfaces(scene)) == 1
    assert not box_surfaces.edited(scene)


def test_results_of_an_earlier_version_are_the_scenes_own(blender: ModuleType, run) -> None:
    scene, folder = run
    blender.ops.roigs.load_results()
    items = [item for item in scene.objects if item.roigs.kind == "SPLATS"]
    scene.roigs.property_unset("result_mark")
    for item in items:
        item.roigs.property_unset("result_mark")
    write_result(folder, "thing", 300)
    blender.ops.roigs.load_results()
    assert [i for i in scene.objects if i.roigs.kind == "SPLATS"] == items
    assert sorted(len(item.data.vertices) for item in items) == [301, 302, 303]
    write_result(folder, "other", 400)
    (folder / "rois" / "thing.ply").unlink()
    blender.ops.roigs.load_results()
    names = {item.name for item in scene.objects if item.roigs.kind == "SPLATS"}
    assert names == {"Background", "other Gaussians", "other first pass"}


def test_results_stay_the_scenes_own_without_their_run(
    blender: ModuleType, run, tmp_path: Path
) -> None:
    """The run folder is gone, or at another place, and the scene trains anew."""
    scene, folder = run
    blender.ops.roigs.load_results()
    names = {item.name for item in scene.objects}
    folder.rename(tmp_path / "away")
    write_result(tmp_path / "new", "thing", 300)
    scene.roigs.run_dir = str(tmp_path / "new")
    blender.ops.roigs.load_results()
    assert {item.name for item in scene.objects} == names
    counts = {len(i.data.vertices) for i in scene.objects if i.roigs.kind == "SPLATS"}
    assert counts == {301, 302, 303}
