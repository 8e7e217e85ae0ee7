"""A scene set up by floor, size and origin."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.scene_transform import FILE
from tests.addon.placement_cases import matrix, moved, select_points, triangle
from tests.addon.scenes import add_box, imported, record

pytestmark = pytest.mark.blender


def test_the_floor_is_at_zero(blender: ModuleType, garden) -> None:
    from roigs_addon.scene import lookup

    scene, _ = garden
    roi = add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    before = record(roi, scene)
    chosen = select_points(blender, scene, triangle(scene))
    blender.ops.roigs.set_floor()
    assert blender.context.mode == "OBJECT"
    np.testing.assert_allclose(moved(matrix(scene), chosen)[:, 2], 0, atol=1e-5)
    eyes = [camera.matrix_world.translation.z for camera in lookup.cameras(scene).values()]
    assert np.median(eyes) > 0.1
    assert record(roi, scene) == before, "the box moved on the object"
    blender.ops.roigs.set_floor(first=(0, 0, 7), second=(1, 0, 7), third=(0, 1, 7))
    assert np.median([c.matrix_world.translation.z for c in lookup.cameras(scene).values()]) > 6


def test_a_known_length(blender: ModuleType, garden) -> None:
    scene, _ = garden
    chosen = select_points(blender, scene, triangle(scene)[:2])
    before = matrix(scene)
    blender.ops.roigs.set_scale(length=0.2)
    a, b = moved(matrix(scene), chosen)
    assert np.linalg.norm(b - a) == pytest.approx(0.2, rel=1e-5)
    factor = np.cbrt(np.linalg.det(matrix(scene)[:3, :3]) / np.linalg.det(before[:3, :3]))
    np.testing.assert_allclose(matrix(scene)[:3], factor * before[:3], atol=1e-5)
    blender.ops.roigs.set_scale(first=a, second=b, length=4)
    a, b = moved(matrix(scene), chosen)
    assert np.linalg.norm(b - a) == pytest.approx(4, rel=1e-4)


def test_the_origin_is_under_the_object(blender: ModuleType, garden) -> None:
    from roigs_addon.scene.box_faces import Shape

    scene, _ = garden
    blender.context.scene.cursor.location = 0.2, 0.1, 0.05
    blender.ops.roigs.add_roi()
    roi = blender.context.active_object
    before = record(roi, scene)
    blender.ops.roigs.set_origin()
    blender.context.view_layer.update()
    place = roi.matrix_world.translation
    assert tuple(place) == pytest.approx((0, 0, Shape.of(roi).half[2]), abs=1e-5)
    assert record(roi, scene) == before


def test_the_origin_is_under_a_hidden_object(blender: ModuleType, garden) -> None:
    scene, _ = garden
    roi = add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    roi.hide_viewport = True
    blender.context.view_layer.update()
    scene.roigs.root.location = 4, 5, 6
    blender.ops.roigs.set_origin(keep_height=False)
    roi.hide_viewport = False
    blender.context.view_layer.update()
    assert tuple(roi.matrix_world.translation) == pytest.approx((0, 0, 0.3), abs=1e-5)


def test_a_set_floor_stays_below_an_object_on_a_table(blender: ModuleType, garden) -> None:
    bpy = blender
    bpy.ops.roigs.set_floor(first=(0, 0, -3), second=(1, 0, -3), third=(0, 1, -3))
    roi = add_box(bpy, "thing", (0.7, -0.3, 2.7), (1.3, 0.3, 3.3))
    height = roi.matrix_world.translation.z
    assert height > 2
    bpy.ops.roigs.set_origin()
    bpy.context.view_layer.update()
    assert tuple(roi.matrix_world.translation) == pytest.approx((0, 0, height), abs=1e-5)
    bpy.ops.roigs.set_origin(keep_height=False)
    bpy.context.view_layer.update()
    assert roi.matrix_world.translation.z == pytest.approx(0.3, abs=1e-5)


def test_a_floor_that_is_a_slope_is_warned_of(
    blender: ModuleType, garden, capfd: pytest.CaptureFixture[str]
) -> None:
    bpy = blender
    slope = {"first": (0, 0, -3), "second": (1, 0, -3)}
    bpy.ops.roigs.set_floor(**slope, third=(0, 1, -2.9))
    told = capfd.readouterr().out
    assert "Turned the model by 6°. Saved in" in told and "Ctrl+Z" not in told
    bpy.ops.roigs.set_floor(**slope, third=(0, 1, -2))
    told = capfd.readouterr().out
    assert "Turned the model by 45°" in told
    assert told.count("from level for the cameras") == 1 and "Ctrl+Z" in told


@pytest.mark.parametrize("factor", [1000.0, 0.001])
@pytest.mark.parametrize("by_hand", [False, True])
def test_tools_in_scenes_of_any_size(
    blender: ModuleType, garden, factor: float, by_hand: bool
) -> None:
    from roigs_addon.scene import box_faces, lookup

    bpy, (scene, folder) = blender, garden
    camera = lookup.cameras(scene)["photo 3.png"]
    clips = np.array([camera.data.clip_start, camera.data.clip_end])
    if by_hand:
        scene.roigs.root.scale = [factor] * 3
        bpy.context.view_layer.update()
    else:
        bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=factor)
    bpy.ops.roigs.look_through(photo="photo 3.png")
    found = camera.data.clip_start, camera.data.clip_end
    np.testing.assert_allclose(found, np.maximum(clips * factor, 1e-6), rtol=1e-5)
    scene.cursor.location = 0, 0, 0
    bpy.ops.roigs.add_roi()
    roi = bpy.context.active_object
    bpy.context.view_layer.update()
    first = lookup.box(roi, scene)
    assert 0.2 < first.half_extents.max() < 2
    bpy.ops.roigs.fit_box()
    bpy.context.view_layer.update()
    half = box_faces.Shape.of(roi).half
    bpy.ops.roigs.move_face(axis=0, sign=1, distance=0.1 * factor)
    bpy.context.view_layer.update()
    half[0] += 0.05 * factor
    np.testing.assert_allclose(box_faces.Shape.of(roi).half, half, rtol=1e-4)
    bpy.ops.roigs.set_origin()
    chosen = select_points(bpy, scene, triangle(scene))
    bpy.ops.roigs.set_floor()
    np.testing.assert_allclose(moved(matrix(scene), chosen)[:, 2] / factor, 0, atol=1e-5)
    imported(bpy, folder)
    again = lookup.cameras(scene)["photo 3.png"]
    np.testing.assert_allclose((again.data.clip_start, again.data.clip_end), found, rtol=1e-4)


def view_of(bpy: ModuleType):
    """A 3D view."""
    screens = (window.screen for window in bpy.context.window_manager.windows)
    area = next(area for screen in screens for area in screen.areas if area.type == "VIEW_3D")
    return area.spaces.active


def test_views_and_the_3d_cursor_come_along(blender: ModuleType, garden) -> None:
    bpy, (scene, folder) = blender, garden
    view, cursor = view_of(bpy), scene.cursor
    eyes = [c.matrix_world.translation for c in bpy.data.objects if c.roigs.kind == "CAMERA"]
    far = max((eye - view.region_3d.view_location).length for eye in eyes)
    assert far < view.region_3d.view_distance < 5 * far, "the import is framed"
    view.region_3d.view_location = before = 0.3, 0.2, 0.1
    away, turned = view.region_3d.view_distance, tuple(view.region_3d.view_rotation)
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    np.testing.assert_allclose(view.region_3d.view_location, np.multiply(before, 3), rtol=1e-5)
    assert view.region_3d.view_distance == pytest.approx(3 * away)
    assert tuple(cursor.location) == (0, 0, 0), "nobody has set it"
    cursor.location, before = view.region_3d.view_location, matrix(scene)
    bpy.ops.roigs.set_floor(first=(0, 0, -3), second=(1, 0, -3), third=(0, 1, -2))
    moving = matrix(scene) @ np.linalg.inv(before)
    wanted = moved(moving, np.array([[0.9, 0.6, 0.3]]))[0]
    np.testing.assert_allclose(view.region_3d.view_location, wanted, atol=1e-4)
    np.testing.assert_allclose(cursor.location, wanted, atol=1e-4)
    turn = np.array(cursor.matrix.to_3x3())
    np.testing.assert_allclose(turn, moving[:3, :3], atol=1e-4)
    assert tuple(view.region_3d.view_rotation) == turned
    imported(bpy, folder)
    np.testing.assert_allclose(view.region_3d.view_location, wanted, atol=1e-4)


def test_the_users_clip_range_stays(blender: ModuleType, garden) -> None:
    from roigs_addon.scene import lookup

    camera = lookup.cameras(garden[0])["photo 3.png"]
    camera.data.clip_end = 7.0
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    assert camera.data.clip_end == 7.0


def test_what_is_not_below_the_root_moves_too(blender: ModuleType, garden) -> None:
    bpy, (scene, _) = blender, garden
    roi = add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    place = roi.matrix_world.copy()
    roi.parent = None
    roi.matrix_world = place
    own = bpy.data.objects.new("own", None)
    scene.collection.objects.link(own)
    own.location = 1, 1, 1
    bpy.context.view_layer.update()
    before = np.array(record(roi, scene)["half_extents"])
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=3)
    np.testing.assert_allclose(record(roi, scene)["half_extents"], before, rtol=1e-5)
    assert tuple(own.matrix_world.translation) == (1, 1, 1)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ({"first": (0, 0, 0), "second": (1, 1, 1), "third": (2, 2, 2)}, "on one line"),
        ({}, "Select at least three points"),
    ],
)
def test_points_that_are_no_floor(blender: ModuleType, garden, points, text: str) -> None:
    before = matrix(garden[0])
    with pytest.raises(RuntimeError, match=text):
        blender.ops.roigs.set_floor(**points)
    np.testing.assert_array_equal(matrix(garden[0]), before)
    assert not (garden[1] / FILE).exists()


def test_points_that_have_no_distance(blender: ModuleType, garden) -> None:
    with pytest.raises(RuntimeError, match="The two points coincide"):
        blender.ops.roigs.set_scale(first=(1, 1, 1), second=(1, 1, 1))
    select_points(blender, garden[0], triangle(garden[0]))
    with pytest.raises(RuntimeError, match="two points in edit mode, not 3"):
        blender.ops.roigs.set_scale()


def test_a_stretched_root_is_refused(blender: ModuleType, garden) -> None:
    garden[0].roigs.root.scale = 1, 2, 1
    blender.context.view_layer.update()
    with pytest.raises(RuntimeError, match="unevenly"):
        blender.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1))


NOWHERE = float("nan"), float("inf"), 1e30


@pytest.mark.parametrize("number", NOWHERE, ids=str)
def test_points_that_are_nowhere_move_nothing(blender: ModuleType, garden, number: float) -> None:
    """They had made the scene a point, or its file unreadable."""
    scene, folder = garden
    before = matrix(scene)
    points = {"first": (number, 0, 0), "second": (1, number, 0), "third": (0, 1, number)}
    two = {name: points[name] for name in ("first", "second")}
    for place, given in (("set_floor", points), ("set_scale", two), ("set_scale", two)):
        with pytest.raises(RuntimeError) as caught:
            getattr(blender.ops.roigs, place)(**given)
        assert "Traceback" not in str(caught.value)
        np.testing.assert_array_equal(matrix(scene), before)
    assert not (folder / FILE).exists()


def test_a_length_out_of_any_range_moves_nothing(blender: ModuleType, garden) -> None:
    scene, _ = garden
    before = matrix(scene)
    with pytest.raises(RuntimeError, match="cannot be moved there: it is too far away"):
        blender.ops.roigs.set_scale(first=(0, 0, 0), second=(1, 0, 0), length=1e38)
    np.testing.assert_array_equal(matrix(scene), before)


def test_a_scene_that_is_too_far_away_is_not_kept(blender: ModuleType, garden) -> None:
    scene, folder = garden
    scene.roigs.root.location.x = 1e20
    with pytest.raises(RuntimeError, match="too far away"):
        blender.ops.roigs.keep_placement()
    assert not (folder / FILE).exists()


def test_a_root_that_does_not_stay_is_named(blender: ModuleType, garden) -> None:
    scene, folder = garden
    root = scene.roigs.root
    scale = {"first": (0, 0, 0), "second": (1, 0, 0), "length": 3}
    constraint = root.constraints.new("LIMIT_SCALE")
    constraint.use_max_x = constraint.use_max_y = constraint.use_max_z = True
    constraint.max_x = constraint.max_y = constraint.max_z = 1.0
    before = matrix(scene)
    with pytest.raises(RuntimeError, match="animated or has constraints"):
        blender.ops.roigs.set_scale(**scale)
    root.constraints.remove(constraint)
    np.testing.assert_allclose(matrix(scene), before, atol=1e-5)
    root.keyframe_insert("scale")
    with pytest.raises(RuntimeError, match="animated or has constraints"):
        blender.ops.roigs.set_scale(**scale)
    np.testing.assert_allclose(matrix(scene), before, atol=1e-5)
    assert not (folder / FILE).exists()
    root.animation_data_clear()
    assert blender.ops.roigs.set_scale(**scale) == {"FINISHED"}


def test_edit_mode_ends_before_the_scene_is_moved(blender: ModuleType, garden) -> None:
    """An undo step of edit mode holds no objects."""
    scene, _ = garden
    add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    floor = {"first": (0, 0, 0), "second": (1, 0, 0), "third": (0, 1, 0)}
    for name, given in (("set_origin", {}), ("set_floor", floor)):
        select_points(blender, scene, triangle(scene))
        getattr(blender.ops.roigs, name)(**given)
        assert blender.context.mode == "OBJECT"
