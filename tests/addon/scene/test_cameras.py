"""Blender's cameras against COLMAP's projection, in Blender."""

from __future__ import annotations

from dataclasses import astuple
from types import ModuleType

import numpy as np
import pytest

from tests.addon.roots import ROOTS, new_root
from tests.poses import Y_DOWN, look_at

pytestmark = pytest.mark.blender

# width, height, fx, fy, cx, cy
SHAPES = [
    (640, 480, 600.0, 600.0, 320.0, 240.0),
    (480, 640, 600.0, 600.0, 240.0, 320.0),
    (4000, 3000, 3500.0, 2800.0, 2100.5, 1333.25),
    (3000, 4000, 2800.0, 3500.0, 1222.5, 2345.75),
    (1920, 1080, 900.0, 1500.0, 10.0, 1070.0),
]


def photo(shape: tuple, pose: np.ndarray):
    from roigs_addon.geometry.frames import Intrinsics
    from roigs_addon.geometry.photo import Photo

    keys = ("width", "height", "fx", "fy", "cx", "cy")
    return Photo(
        name="a.jpg",
        path="",
        intrinsics=Intrinsics(**dict(zip(keys, shape, strict=True))),
        world_to_camera=tuple(tuple(row) for row in pose.tolist()),
    )


def new_camera(bpy: ModuleType, shape: tuple, pose: np.ndarray, root):
    from roigs_addon.scene import cameras

    item = cameras.new_camera(photo(shape, pose), 0.1)
    item.parent = root
    bpy.context.scene.collection.objects.link(item)
    cameras.activate(bpy.context.scene, item)
    bpy.context.view_layer.update()
    return item


def pinhole(scene):
    """The active camera in pixels, at the scene's resolution."""
    from roigs_addon.scene import cameras

    size = cameras.render_size(scene.render)
    return cameras.intrinsics_of(scene.camera.data, scene.render, *size)


def blender_pixels(bpy: ModuleType, item, world: np.ndarray) -> np.ndarray:
    """(N, 2) by Blender's own projection."""
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    scene = bpy.context.scene
    share = scene.render.resolution_percentage / 100
    size = int(scene.render.resolution_x * share), int(scene.render.resolution_y * share)
    views = [world_to_camera_view(scene, item, Vector(point)) for point in world]
    return np.array([(v.x * size[0], (1 - v.y) * size[1]) for v in views])


def project(k, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    local = points @ pose[:3, :3].T + pose[:3, 3]
    return local[:, :2] / local[:, 2:] * (k.fx, k.fy) + (k.cx, k.cy)


@pytest.mark.parametrize("kind", ROOTS)
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_points_fall_where_colmap_sees_them(
    blender: ModuleType, addon: ModuleType, shape: tuple, kind: str
) -> None:
    pose = look_at([2.0, -1.5, -3.0], up=Y_DOWN)
    root = new_root(blender, kind)
    item = new_camera(blender, shape, pose, root)
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (200, 3))
    world = points @ np.array(root.matrix_world)[:3, :3].T + np.array(root.matrix_world)[:3, 3]
    seen = blender_pixels(blender, item, world)
    wanted = project(photo(shape, pose).intrinsics, pose, points)
    assert np.abs(seen - wanted).max() < 0.01


@pytest.mark.parametrize("kind", ROOTS)
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_what_goes_back_to_colmap_is_what_came(
    blender: ModuleType, addon: ModuleType, shape: tuple, kind: str
) -> None:
    from roigs_addon.geometry import frames
    from roigs_addon.scene import cameras, lookup

    pose = look_at([2.0, -1.5, -3.0], up=Y_DOWN)
    root = new_root(blender, kind)
    item = new_camera(blender, shape, pose, root)
    assert cameras.photo_of(item, root) == photo(shape, pose)
    back, wanted = pinhole(blender.context.scene), photo(shape, pose).intrinsics
    np.testing.assert_allclose(astuple(back), astuple(wanted), atol=0.01)
    # From Blender's matrices alone: 32-bit floats.
    again = frames.world_to_camera(lookup.matrix_world(item), lookup.matrix_world(root))
    np.testing.assert_allclose(again, pose, atol=1e-5)


def test_a_moved_camera_goes_where_it_was_moved(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.scene import cameras

    pose = look_at([2.0, -1.5, -3.0], up=Y_DOWN)
    root = new_root(blender, "turned and scaled")
    item = new_camera(blender, SHAPES[0], pose, root)
    item.location.x += 0.5  # below the root: in COLMAP's units
    blender.context.view_layer.update()
    moved = cameras.photo_of(item, root).pose
    before, after = (np.linalg.inv(matrix)[:3, 3] for matrix in (pose, moved))
    np.testing.assert_allclose(after - before, [0.5, 0, 0], atol=1e-5)
    np.testing.assert_allclose(moved[:3, :3], pose[:3, :3], atol=1e-6)
    assert pinhole(blender.context.scene).fx == pytest.approx(SHAPES[0][2], abs=0.01)


@pytest.mark.parametrize("percentage", [100, 50, 33])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize(
    ("width", "height", "aspect"), [(640, 480, (1, 1)), (480, 642, (1, 1)), (400, 300, (1, 1.6))]
)
def test_any_camera_of_blender_in_pixels(
    blender: ModuleType,
    addon: ModuleType,
    fit: str,
    percentage: int,
    width: int,
    height: int,
    aspect: tuple,
) -> None:
    from mathutils import Matrix

    from roigs_addon.geometry import frames

    bpy, scene = blender, blender.context.scene
    root = new_root(bpy, "turned and scaled")
    data = bpy.data.cameras.new("own")
    data.sensor_fit, data.lens, data.sensor_width, data.sensor_height = fit, 40.0, 30.0, 17.0
    data.shift_x, data.shift_y = 0.11, -0.07
    item = bpy.data.objects.new("own", data)
    scene.collection.objects.link(item)
    scene.camera = item
    item.matrix_world = Matrix.LocRotScale((1.0, -6.0, 2.0), Matrix.Rotation(1.2, 3, "X"), None)
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = percentage
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    bpy.context.view_layer.update()
    intrinsics = pinhole(scene)
    size = width * percentage // 100, height * percentage // 100
    assert (intrinsics.width, intrinsics.height) == size
    pose = frames.world_to_camera(np.array(item.matrix_world), np.array(root.matrix_world))
    local = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    to_world = np.array(root.matrix_world)
    world = local @ to_world[:3, :3].T + to_world[:3, 3]
    if percentage == 33:  # world_to_camera_view knows no rounded resolution
        return
    seen = blender_pixels(bpy, item, world)
    assert np.abs(seen - project(intrinsics, pose, local)).max() < 0.01
