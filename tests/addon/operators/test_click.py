"""Clicks on Gaussians in the 3D view; the click itself needs a window."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender


@pytest.fixture
def view(blender: ModuleType):
    """From above, without perspective: 100 pixels are 10 units."""
    from mathutils import Matrix

    eye, clip = Matrix.Translation((0, 0, -50)), Matrix.Diagonal((0.2, 0.2, -0.01, 1))
    data = SimpleNamespace(view_matrix=eye, window_matrix=clip, perspective_matrix=clip @ eye)
    data.is_perspective, data.view_perspective = False, "CAMERA"
    return SimpleNamespace(width=100, height=100), data


def test_what_is_in_front(blender: ModuleType, addon: ModuleType, view, tmp_path: Path) -> None:
    from roigs_addon.operators.picking import in_front, shown_points
    from roigs_addon.scene import splats

    bpy = blender
    path = random_ply(tmp_path / "a.ply", 2000)
    item = splats.show_imported(bpy.context.scene, path, "a", in_model=False)
    bpy.ops.mesh.primitive_plane_add(size=4, location=(3, 0, 5))
    place = bpy.data.objects.new("place", None)
    place.instance_type, place.instance_collection = "COLLECTION", bpy.data.collections.new("c")
    place.instance_collection.objects.link(item)
    place.location = (-3, 0, 2)
    bpy.context.scene.collection.objects.link(place)
    bpy.context.view_layer.update()
    shown = shown_points(bpy.context)
    assert [meant.name for meant, _ in shown] == ["a", "place"]
    clouds = [points for _, points in shown]

    def at(x: float, y: float):
        return in_front(bpy.context, view, (50 + 10 * x, 50 + 10 * y), clouds)

    assert at(0, 0)[1] == 0 and at(-3, 0)[1] == 1 and at(0, 4) is None
    assert at(2, 0)[1] == -1, "a mesh"
    assert abs(at(-3, 0)[0].z - 2) < 1.1
    assert np.isclose(at(2, 0)[0].z, 5)

    from roigs_addon.operators.click import surface

    found = surface(bpy.context, (view, (50.5, 50)))
    assert np.allclose(found[:2], (0.05, 0), atol=1e-4), "at the mouse, not at a Gaussian's centre"
    assert np.isclose(found.z, at(0.05, 0)[0].z, atol=1e-4)
    assert surface(bpy.context, (view, (70, 50))) is None, "a mesh, which Blender finds"


def test_what_blender_finds_stays_if_it_is_in_front(
    blender: ModuleType, addon: ModuleType, view
) -> None:
    from mathutils import Vector

    from roigs_addon.operators.click import _stays

    bpy = blender
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    mesh = bpy.data.objects.new("mesh", bpy.data.meshes.new("mesh"))
    box = bpy.data.objects.new("box", None)
    box.roigs.kind = "ROI"
    for item in (camera, mesh, box):
        bpy.context.scene.collection.objects.link(item)
    eye, near, far = view[1].view_matrix, Vector((0, 0, 1)), Vector((0, 0, -1))
    bpy.context.view_layer.update()
    assert _stays(camera, far, eye) and not _stays(camera, near, eye)
    assert not _stays(mesh, far, eye), "its surface, not its origin, was looked at"
    assert _stays(box, near, eye)
