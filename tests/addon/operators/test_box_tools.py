"""Fit to Points, Snap to Floor and Move Face."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from tests.addon.boxes import bounds, points_of
from tests.addon.roots import new_root

pytestmark = pytest.mark.blender

TABLE = -0.5


@pytest.fixture(params=["plain", "turned"])
def table(request: pytest.FixtureRequest, blender: ModuleType, addon: ModuleType):
    """A thing of sides 0.6, 0.4 and 1 on a table, upright in the world, and a box around it."""
    bpy, random = blender, np.random.default_rng(0)
    root = new_root(bpy, request.param)
    bpy.context.view_layer.update()
    thing = random.uniform((-0.3, -0.2, TABLE), (0.3, 0.2, 0.5), (6000, 3))
    top = random.uniform(-2, 2, (3000, 3)) * (1, 1, 0) + (0, 0, TABLE)
    dust = random.uniform(-2, 2, (100, 3))
    inverse = np.linalg.inv(np.array(root.matrix_world))
    world = np.concatenate([thing, top, dust])
    points_of(bpy, root, world @ inverse[:3, :3].T + inverse[:3, 3])
    bpy.context.scene.cursor.location = 0.05, 0, 0.1
    bpy.ops.roigs.add_roi()
    roi = bpy.context.active_object
    roi.scale = 0.8, 0.8, 0.55
    bpy.context.view_layer.update()
    return roi


def test_fit(blender: ModuleType, table) -> None:
    from roigs_addon.scene import lookup

    assert blender.ops.roigs.fit_box() == {"FINISHED"}
    low, high = bounds(blender, table)
    np.testing.assert_allclose(low, (-0.3, -0.2, -0.45), atol=0.1)
    np.testing.assert_allclose(high, (0.3, 0.2, 0.5), atol=0.1)
    lookup.box(table, blender.context.scene)  # still a box


def test_a_fit_to_few_points_is_warned_of(
    blender: ModuleType, addon: ModuleType, capfd: pytest.CaptureFixture[str]
) -> None:
    blender.ops.roigs.add_roi()
    cloud = points_of(blender, None, np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3)))
    blender.ops.roigs.fit_box()
    assert "Fitted to 30 points only: check each face" in capfd.readouterr().out
    blender.data.objects.remove(cloud)
    points_of(blender, None, np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3)))
    blender.ops.roigs.fit_box()
    assert "check each face" not in capfd.readouterr().out


def test_a_box_that_a_constraint_turns(blender: ModuleType, table) -> None:
    target = blender.data.objects.new("target", None)
    blender.context.scene.collection.objects.link(target)
    target.rotation_euler = 0, 0, np.pi / 2
    constraint = table.constraints.new("COPY_ROTATION")
    constraint.target = target
    table.location.x += 0.3
    blender.context.view_layer.update()
    blender.ops.roigs.fit_box()
    low, high = bounds(blender, table)
    np.testing.assert_allclose(low, (-0.3, -0.2, -0.45), atol=0.1)
    np.testing.assert_allclose(high, (0.3, 0.2, 0.5), atol=0.1)


def test_fit_to_vertices_selected_in_edit_mode(blender: ModuleType, table) -> None:
    bpy = blender
    cloud = next(o for o in bpy.context.scene.objects if o.roigs.kind == "POINTS")
    world = np.array([cloud.matrix_world @ v.co for v in cloud.data.vertices])
    upper = (world[:, 2] > 0.2) & (np.abs(world) < 0.6).all(axis=1)
    bpy.context.view_layer.objects.active = cloud
    cloud.data.vertices.foreach_set("select", upper)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.roigs.fit_box()
    assert bpy.context.mode == "OBJECT"
    low, high = bounds(bpy, table)
    np.testing.assert_allclose(low[2], 0.2, atol=0.05)
    np.testing.assert_allclose(high, (0.3, 0.2, 0.5), atol=0.06)


def test_snap(blender: ModuleType, table) -> None:
    before = bounds(blender, table)
    blender.ops.roigs.snap_box()
    after = bounds(blender, table)
    assert after[0, 2] == pytest.approx(TABLE, abs=0.02)
    after[0, 2] = before[0, 2]
    np.testing.assert_allclose(after, before, atol=1e-5)  # only the bottom has moved


@pytest.mark.parametrize("hidden", ["POINTS", "ROI"])
def test_what_is_hidden_moves_with_the_scene(blender: ModuleType, table, hidden: str) -> None:
    bpy = blender
    bpy.ops.roigs.fit_box()
    before = bounds(bpy, table)
    item = next(o for o in bpy.context.scene.objects if o.roigs.kind == hidden)
    item.hide_viewport = True
    bpy.context.view_layer.update()
    root = bpy.context.scene.roigs.root
    root.location, root.scale = 2 * root.location, 2 * root.scale
    bpy.context.view_layer.update()
    assert bpy.ops.roigs.fit_box() == {"FINISHED"}
    assert bpy.ops.roigs.snap_box() == {"FINISHED"}
    item.hide_viewport = False
    after = bounds(bpy, table)
    assert after[0, 2] == pytest.approx(2 * TABLE, abs=0.04)
    before[0, 2] = after[0, 2] / 2
    np.testing.assert_allclose(after, 2 * before, atol=0.1)


def test_a_box_that_stands_on_its_head(blender: ModuleType, table) -> None:
    table.rotation_euler = np.pi, 0, 0
    blender.context.view_layer.update()
    top = bounds(blender, table)[1, 2]
    blender.ops.roigs.snap_box()
    after = bounds(blender, table)
    assert after[0, 2] == pytest.approx(TABLE, abs=0.02)
    assert after[1, 2] == pytest.approx(top, abs=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_face_moves(blender: ModuleType, table, axis: int, sign: int) -> None:
    before = bounds(blender, table)
    blender.ops.roigs.move_face(axis=axis, sign=sign, distance=0.25)
    after = bounds(blender, table)
    expected = before.copy()
    expected[1 if sign > 0 else 0, axis] += 0.25 * sign
    np.testing.assert_allclose(after, expected, atol=1e-5)
    blender.ops.roigs.move_face(axis=axis, sign=sign, distance=-0.25, both=True)
    expected[:, axis] += 0.25, -0.25
    np.testing.assert_allclose(bounds(blender, table), expected, atol=1e-5)


def test_a_face_stays_on_its_side(blender: ModuleType, table) -> None:
    low = bounds(blender, table)[0]
    blender.ops.roigs.move_face(axis=0, sign=1, distance=-50)
    after = bounds(blender, table)
    assert after[0, 0] == pytest.approx(low[0], abs=1e-5) and after[1, 0] > after[0, 0]


def test_handles_are_on_the_faces(blender: ModuleType, table) -> None:
    from roigs_addon.scene import box_faces
    from roigs_addon.ui.box_handles import FACES, BoxHandles

    low, high = bounds(blender, table)
    for axis, sign in FACES:
        frame = np.array(box_faces.face_matrix(table, (axis, sign)))
        expected = (low + high) / 2
        expected[axis] = (high if sign > 0 else low)[axis]
        np.testing.assert_allclose(frame[:3, 3], expected, atol=1e-5)
        np.testing.assert_allclose(frame[axis, 2], sign, atol=1e-5)
    assert not BoxHandles.poll(blender.context)  # no 3D view here


def test_what_is_missing_is_said(blender: ModuleType, addon: ModuleType) -> None:
    for tool in (blender.ops.roigs.fit_box, blender.ops.roigs.snap_box):
        assert not tool.poll()
    blender.ops.roigs.add_roi()
    blender.context.view_layer.update()
    for tool in (blender.ops.roigs.fit_box, blender.ops.roigs.snap_box):
        with pytest.raises(RuntimeError, match="no sparse points"):
            tool()
    cloud = points_of(blender, None, np.full((50, 3), 9.0))
    with pytest.raises(RuntimeError, match="too few points in 'Box 1'"):
        blender.ops.roigs.fit_box()
    with pytest.raises(RuntimeError, match="too few points around and below"):
        blender.ops.roigs.snap_box()
    blender.context.scene.objects["Box 1"].scale.x = 0
    blender.context.view_layer.update()
    with pytest.raises(RuntimeError, match="no volume"):
        blender.ops.roigs.fit_box()
    assert cloud
