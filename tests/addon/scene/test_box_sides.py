"""A box's `scale` stays (1, 1, 1): Blender 5.2 warns of an object whose scale is uneven."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.addon.roots import ROOTS, new_root

pytestmark = pytest.mark.blender

CORNERS = {"low": (-0.5, -1, 0), "high": (0.5, 1, 0.5)}


def no_notice(roi) -> None:
    """Blender's own condition, in its status bar."""
    assert roi.scale[0] == roi.scale[1] == roi.scale[2]
    # View Selected frames an empty by its scale.
    assert roi.scale[0] * roi.empty_display_size == pytest.approx(max(roi.roigs.half_sides))


def half_sides(bpy: ModuleType, roi) -> np.ndarray:
    """In the COLMAP frame."""
    from roigs_addon.scene import lookup

    bpy.context.view_layer.update()
    return lookup.box(roi, bpy.context.scene).half_extents


def clicked(bpy: ModuleType):
    """A box as the button adds it, around a mesh of sides 1, 2 and 4."""
    from tests.addon.boxes import cube

    cube(bpy).select_set(True)
    bpy.ops.roigs.add_roi(for_script=False)
    bpy.context.view_layer.update()
    return bpy.context.active_object


def corners_box(bpy: ModuleType, name: str = "vase"):
    bpy.ops.roigs.add_box(name=name, **CORNERS)
    bpy.context.view_layer.update()
    return bpy.data.objects[name]


@pytest.mark.parametrize("kind", ["none", *ROOTS, "uneven"])
def test_a_new_box(blender: ModuleType, addon: ModuleType, kind: str) -> None:
    root = None if kind == "none" else new_root(blender, "turned" if kind == "uneven" else kind)
    if kind == "uneven":
        root.scale = 1, 2, 3
    blender.context.view_layer.update()
    roi = clicked(blender)
    no_notice(roi)
    corner = np.abs(np.array(roi.matrix_world.to_3x3())).sum(axis=1)
    assert (corner > np.array([0.5, 1, 2])).all()  # holds the mesh
    no_notice(corners_box(blender))
    np.testing.assert_allclose(half_sides(blender, blender.data.objects["vase"]), (0.5, 1, 0.25))


@pytest.mark.parametrize("kind", ROOTS)
@pytest.mark.parametrize("parent", ["root", "none", "other"])
def test_a_moved_face(blender: ModuleType, addon: ModuleType, kind: str, parent: str) -> None:
    """Also of a box that a script, or an older version, has sized by `scale`."""
    from mathutils import Euler, Matrix

    from tests.addon.boxes import bounds

    new_root(blender, kind)
    blender.context.view_layer.update()
    blender.ops.roigs.add_roi()
    roi = blender.context.active_object
    if parent != "root":
        roi.parent = None
    if parent == "other":
        other = blender.data.objects.new("other", None)
        blender.context.scene.collection.objects.link(other)
        other.scale = 3, 3, 3
        roi.parent = other
    blender.context.view_layer.update()
    place = Matrix.LocRotScale((1, 2, 3), Euler((0, 0, np.pi / 2)), (0.5, 1, -2))
    roi.matrix_world = place  # (1, 0.5, 2) along the world's axes
    before = bounds(blender, roi)
    np.testing.assert_allclose(before, [(0, 1.5, 1), (2, 2.5, 5)], atol=1e-5)
    blender.ops.roigs.move_face(axis=0, sign=1, distance=0.25)  # its x is the world's y
    no_notice(roi)
    before[1, 1] += 0.25
    np.testing.assert_allclose(bounds(blender, roi), before, atol=1e-4)
    blender.ops.roigs.move_face(axis=1, sign=1, distance=0.5, both=True)
    no_notice(roi)
    before[:, 0] += -0.5, 0.5
    np.testing.assert_allclose(bounds(blender, roi), before, atol=1e-4)


def test_fit(blender: ModuleType, addon: ModuleType) -> None:
    from tests.addon.boxes import points_of

    root, random = new_root(blender, "turned and scaled"), np.random.default_rng(0)
    roi = corners_box(blender)
    points_of(blender, root, random.uniform(-1, 1, (9000, 3)) * (0.2, 0.3, 0.4))
    blender.ops.roigs.fit_box()
    no_notice(roi)
    np.testing.assert_allclose(half_sides(blender, roi), (0.2, 0.3, 0.2), atol=0.02)


@pytest.mark.parametrize("by_scale", [False, True])
def test_esc_gives_back_the_box(blender: ModuleType, addon: ModuleType, by_scale: bool) -> None:
    from roigs_addon.operators.box_tools import MoveFace
    from roigs_addon.scene import box_faces

    roi = corners_box(blender)
    if by_scale:
        roi.delta_scale, roi.scale = (1, 1, 1), (0.3, 0.2, -0.7)
    before = list(roi.location), list(roi.scale), list(roi.delta_scale)
    shape = box_faces.Shape.of(roi)
    box_faces.move_face(roi, shape, (0, 1), 3.0)
    assert before != (list(roi.location), list(roi.scale), list(roi.delta_scale))
    operator = SimpleNamespace(_roi=roi.name, _shape=shape)
    event = SimpleNamespace(type="ESC")
    assert MoveFace.modal(operator, blender.context, event) == {"CANCELLED"}
    assert before == (list(roi.location), list(roi.scale), list(roi.delta_scale))


def test_the_button(blender: ModuleType, addon: ModuleType) -> None:
    """Without a window Blender invokes nothing."""
    from roigs_addon.operators.boxes import AddRoi

    button = SimpleNamespace(for_script=True, execute=lambda _: {"FINISHED"})
    assert AddRoi.invoke(button, blender.context, None) == {"FINISHED"}
    assert not button.for_script


def test_undo_and_duplicates(blender: ModuleType, addon: ModuleType) -> None:
    bpy = blender
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="nothing")
    clicked(bpy)
    bpy.ops.ed.undo_push(message="a box")
    bpy.ops.roigs.move_face(axis=0, sign=1, distance=1.0)
    bpy.ops.ed.undo_push(message="a face")
    moved = half_sides(bpy, bpy.data.objects["Box 1"])
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    no_notice(copy)
    np.testing.assert_array_equal(half_sides(bpy, copy), moved)
    bpy.ops.ed.undo()
    box = bpy.data.objects["Box 1"]
    np.testing.assert_allclose(half_sides(bpy, box), np.array([0.5, 1, 2]) * 1.05, rtol=1e-5)


def test_blenders_own_scaling(blender: ModuleType, addon: ModuleType) -> None:
    roi = corners_box(blender)
    roi.scale = 2, 2, 2  # S 2
    np.testing.assert_allclose(half_sides(blender, roi), (1, 2, 0.5))
    np.testing.assert_allclose(roi.roigs.half_sides, (1, 2, 0.5))
    roi.scale = 2, 1, 1  # S X: here the notice is right
    np.testing.assert_allclose(half_sides(blender, roi), (1, 1, 0.25))
    roi.empty_display_size = 0.5
    np.testing.assert_allclose(half_sides(blender, roi), roi.roigs.half_sides)
    roi.roigs.half_sides = 3, 2, 1  # as the panel does
    no_notice(roi)
    np.testing.assert_allclose(half_sides(blender, roi), (3, 2, 1))


def test_a_script_sizes_its_box_by_scale(blender: ModuleType, addon: ModuleType) -> None:
    blender.ops.roigs.add_roi()
    roi = blender.context.active_object
    roi.scale = 0.5, 1, 2
    np.testing.assert_allclose(half_sides(blender, roi), (0.5, 1, 2))
    np.testing.assert_allclose(roi.roigs.half_sides, (0.5, 1, 2))


def test_scaling_the_scene_scales_a_box_that_hangs_nowhere(
    blender: ModuleType, addon: ModuleType
) -> None:
    new_root(blender, "plain")
    roi = corners_box(blender)
    roi.parent = None
    blender.ops.roigs.set_scale(first=(0, 0, 0), second=(1, 0, 0), length=4.0)
    np.testing.assert_allclose(np.array(roi.matrix_world.to_scale()), (2, 4, 1), rtol=1e-5)
    np.testing.assert_allclose(roi.scale, 4, rtol=1e-5)  # even
