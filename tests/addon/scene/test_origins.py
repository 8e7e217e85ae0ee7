"""The origin of a box's Gaussians is in their box, and they stand where they were trained."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.addon.results import PARTS, cut, set_aside
from tests.addon.splat_cases import random_arrays

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]

CENTRE = (2.0, -1.0, 0.5)
COUNT = 60


def far_ply(path: Path, seed: int) -> None:
    """Gaussians around the centre."""
    arrays = random_arrays(COUNT, seed)
    write_ply(path, arrays | {"means": arrays["means"] * 0.3 + np.float32(CENTRE)})


@pytest.fixture
def far(blender: ModuleType, run):
    """A box far from the COLMAP origin and its objects, refined and coarse; root turned."""
    scene, folder = run
    box = scene.objects["thing"]
    box.matrix_parent_inverse.identity()
    box.location = CENTRE
    scene.roigs.root.location, scene.roigs.root.scale = (3, 4, 5), (2, 2, 2)
    for seed, part in enumerate(("rois", "coarse")):
        far_ply(folder / part / "thing.ply", seed)
    blender.context.view_layer.update()
    blender.ops.roigs.load_results()
    blender.context.view_layer.update()
    return scene, folder


def world_points(item) -> np.ndarray:
    """Where the vertices are."""
    from roigs_addon.scene.clouds import positions

    world = np.array(item.matrix_world)
    return positions(item) @ world[:3, :3].T + world[:3, 3]


def drawn_points(item) -> np.ndarray:
    """Where the viewport draws Gaussians."""
    from roigs_addon.viewport.objects import marked

    (found,) = marked([item])
    world = np.array(found.matrix)
    return read_ply(found.file.path)["means"] @ world[:3, :3].T + world[:3, 3]


def trained(scene, path: Path) -> np.ndarray:
    """Where the points of a file are below the root."""
    root = np.array(scene.roigs.root.matrix_world)
    return read_ply(path)["means"] @ root[:3, :3].T + root[:3, 3]


def assert_close(*points: np.ndarray) -> None:
    for other in points[1:]:
        np.testing.assert_allclose(points[0], other, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "part"), [("thing Gaussians", "rois"), ("thing first pass", "coarse")]
)
def test_it_is_the_centre_of_the_box(blender: ModuleType, far, name: str, part: str) -> None:
    scene, folder = far
    item, box = scene.objects[name], scene.objects["thing"]
    blender.ops.roigs.set_detail(roi="thing", fine=part == "rois")
    blender.context.view_layer.update()
    np.testing.assert_allclose(item.matrix_world.translation, box.matrix_world.translation)
    places = trained(scene, folder / part / "thing.ply")
    assert_close(places, world_points(item), drawn_points(item))
    assert tuple(scene.objects["Background"].location) == (0, 0, 0)


def test_without_the_box_it_is_the_centre_of_the_points(blender: ModuleType, far) -> None:
    scene, folder = far
    for name in ("thing", "thing Gaussians", "thing first pass"):
        blender.data.objects.remove(scene.objects[name])
    blender.ops.roigs.load_results()
    blender.context.view_layer.update()
    item = scene.objects["thing Gaussians"]
    np.testing.assert_allclose(item.location, CENTRE, atol=0.2)
    assert_close(trained(scene, folder / "rois" / "thing.ply"), drawn_points(item))


def apply_all(bpy: ModuleType, item) -> None:
    bpy.ops.roigs.select_gaussians(name=item.name)
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)


def set_origin(bpy: ModuleType, item) -> None:
    bpy.ops.roigs.select_gaussians(name=item.name)
    bpy.ops.object.origin_set(type="ORIGIN_GEOMETRY")


@pytest.mark.parametrize("change", [apply_all, set_origin])
@pytest.mark.parametrize("old", [False, True])
def test_points_stay_in_their_places(blender: ModuleType, far, change, old: bool) -> None:
    """Also of objects that were loaded before: their origin was that of COLMAP."""
    bpy, (scene, folder) = blender, far
    item = scene.objects["thing Gaussians"]
    if old:
        from roigs_addon.scene import edits

        item.location = 0, 0, 0
        item.data.transform(item.matrix_local.Translation(CENTRE))
        for name in ("roigs_frame", "roigs_file"):
            del item.data[name]
        edits.mark_imported(item.data)
    bpy.context.view_layer.update()
    places = trained(scene, folder / "rois" / "thing.ply")
    assert_close(places, world_points(item), drawn_points(item))
    change(bpy, item)
    assert_close(places, world_points(item), drawn_points(item))
    older = set_aside(folder)
    for part in PARTS:
        copy = shutil.copytree if (older / part).is_dir() else shutil.copy
        copy(older / part, folder / part)
    far_ply(folder / "rois" / "thing.ply", seed=9)
    bpy.ops.roigs.load_results()
    assert_close(trained(scene, folder / "rois" / "thing.ply"), world_points(item))
    for _ in range(2):
        bpy.ops.roigs.compare_results()
        assert_close(places, world_points(item), drawn_points(item))
        bpy.ops.roigs.compare_results()
        assert_close(trained(scene, folder / "rois" / "thing.ply"), drawn_points(item))
    cut(bpy, item, range(10))
    change(bpy, item)
    left = trained(scene, folder / "rois" / "thing.ply")[10:]
    assert_close(left, drawn_points(item))
    bpy.ops.roigs.compare_results()
    assert_close(places, drawn_points(item))
    bpy.ops.roigs.compare_results()
    assert_close(left, drawn_points(item))


def test_renders_get_them_where_they_were_trained(blender: ModuleType, far) -> None:
    from roigs_addon.scene.frame_request import models_of

    scene, folder = far
    item = scene.objects["thing Gaussians"]
    graph = blender.context.evaluated_depsgraph_get()
    (model,) = models_of([item], [], graph)
    assert model["ply"] == str(folder / "rois" / "thing.ply")
    np.testing.assert_allclose(model["matrix"], scene.roigs.root.matrix_world, atol=1e-5)
