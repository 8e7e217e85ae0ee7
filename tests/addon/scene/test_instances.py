"""Gaussian objects that geometry nodes or collections instance, without making them real."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply
from tests.addon.pictures import load_rgba
from tests.addon.scenes import with_cycles
from tests.addon.splat_cases import random_ply

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]


@pytest.fixture
def vase(blender: ModuleType, addon: ModuleType, tmp_path: Path):
    """An object of 400 Gaussians, away from the origin, with a look of its own."""
    from roigs_addon.scene import splats

    path = random_ply(tmp_path / "vase.ply", 400, seed=2)
    item = splats.show_imported(blender.context.scene, path, "vase", in_model=False)
    item.location, item.roigs.exposure = (0, 0, 30), -0.5
    return item


def scatter(bpy: ModuleType, item):
    """Twenty instances, each turned and of its own size, by geometry nodes."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=3, size=8)
    grid = bpy.context.active_object
    group = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    group.is_modifier = True
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    info = group.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = item
    info.inputs["As Instance"].default_value = True
    place = group.nodes.new("GeometryNodeInstanceOnPoints")
    for kind, low, high, socket in (
        ("FLOAT_VECTOR", (-1, -1, -1), (1, 1, 1), "Rotation"),
        ("FLOAT", 0.4, 1.2, "Scale"),
    ):
        number = group.nodes.new("FunctionNodeRandomValue")
        number.data_type = kind
        at = [s for s in number.inputs if s.enabled]
        at[0].default_value, at[1].default_value = low, high
        group.links.new(next(s for s in number.outputs if s.enabled), place.inputs[socket])
    group.links.new(start.outputs[0], place.inputs["Points"])
    group.links.new(info.outputs["Geometry"], place.inputs["Instance"])
    group.links.new(place.outputs[0], end.inputs[0])
    grid.modifiers.new("scatter", "NODES").node_group = group
    bpy.context.view_layer.update()
    return grid


def in_view(bpy: ModuleType) -> np.ndarray:
    """(N, 4, 4) where the viewport draws Gaussians, in an order of their places."""
    from roigs_addon.viewport.objects import splat_objects

    bpy.context.view_layer.update()
    found = [item for item in splat_objects(bpy.context) if item.visible]
    matrices = np.array([np.array(item.matrix) for item in found]).reshape(-1, 4, 4)
    return matrices[np.lexsort(matrices[:, :3, 3].round(4).T)]


def f12(bpy: ModuleType, path: Path) -> np.ndarray:
    scene = bpy.context.scene
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(scene.camera)
        scene.camera.location.z = 14
    render = with_cycles(scene, samples=1)
    render.resolution_x, render.resolution_y, render.resolution_percentage = 128, 96, 100
    render.dither_intensity, render.filepath = 0.0, str(path)
    bpy.ops.render.render(write_still=True)
    return load_rgba(path)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


def test_twenty_instances_are_drawn_as_if_made_real(
    blender: ModuleType, vase, engine, tmp_path: Path
) -> None:
    bpy = blender
    vase.hide_viewport = vase.hide_render = True  # its instances are seen all the same
    grid = scatter(bpy, vase)
    before = in_view(bpy)
    assert len(before) == 20
    grid.hide_render = True  # with the grid, its instances
    assert f12(bpy, tmp_path / "hidden.png")[..., 3].max() == 0
    grid.hide_render = False
    picture = f12(bpy, tmp_path / "instances.png")
    bpy.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"), up="Z")
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = grid
    grid.select_set(True)
    bpy.ops.object.duplicates_make_real()
    for item in bpy.context.scene.objects:
        if item != vase and item.roigs.kind == "SPLATS":
            item.hide_viewport = item.hide_render = False
    grid.modifiers.clear()
    grid.hide_render = True
    np.testing.assert_allclose(in_view(bpy), before, atol=1e-4)
    real = f12(bpy, tmp_path / "real.png")
    assert real[..., 3].mean() > 0.1
    assert psnr(picture, real) > 45
    bpy.ops.roigs.export_gaussians(filepath=str(tmp_path / "b.ply"), up="Z")
    exported = [np.sort(read_ply(tmp_path / f"{n}.ply")["means"], axis=0) for n in "ab"]
    assert len(exported[0]) == 20 * 400
    np.testing.assert_allclose(*exported, atol=1e-3)


@pytest.mark.parametrize("linked", [False, True])
def test_collections_are_drawn(
    blender: ModuleType, vase, engine, tmp_path: Path, linked: bool
) -> None:
    """Also one of another .blend, in a scene that has no Gaussians of its own."""
    bpy = blender
    collection = bpy.data.collections.new("shelf")
    collection.objects.link(vase)
    if linked:
        collection.use_fake_user = True
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shelf.blend"))
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with bpy.data.libraries.load(str(tmp_path / "shelf.blend"), link=True) as (_, into):
            into.collections = ["shelf"]
        collection = bpy.data.collections["shelf"]
    else:
        vase.hide_render = False
        bpy.context.scene.collection.children["ROI-GS Gaussians"].objects.unlink(vase)
    for x in (-2, 2):
        empty = bpy.data.objects.new("place", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location = (x, 0, -30)
        bpy.context.scene.collection.objects.link(empty)
    places = in_view(bpy)
    np.testing.assert_allclose(places[:, 0, 3], [-2, 2], atol=0.2)
    picture = f12(bpy, tmp_path / "f12.png")[..., 3]
    assert picture[:, :64].max() > 0.5 and picture[:, 64:].max() > 0.5
    empty.hide_set(True)
    assert len(in_view(bpy)) == 1
