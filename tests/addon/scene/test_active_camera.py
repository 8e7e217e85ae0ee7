"""Resolution and aspect follow the photo's camera that becomes the active one."""

from __future__ import annotations

from types import ModuleType

import pytest

pytestmark = pytest.mark.blender

CHOSEN = 1920, 1080


@pytest.fixture
def through(blender: ModuleType, garden):
    """The scene, seen through a photo in a resolution of the user's, and its resolution then."""
    scene, _ = garden
    blender.ops.roigs.look_through(photo="photo 1.png")
    blender.context.view_layer.update()
    scene.render.resolution_x, scene.render.resolution_y = CHOSEN
    blender.context.view_layer.update()
    return scene


def size(scene) -> tuple[int, int]:
    return scene.render.resolution_x, scene.render.resolution_y


def test_another_camera(blender: ModuleType, through) -> None:
    assert size(through) == CHOSEN
    through.camera = blender.data.objects["photo 2.png"]
    blender.context.view_layer.update()
    assert size(through) != CHOSEN


@pytest.mark.parametrize("what", ["camera", "scene"])
def test_another_name(blender: ModuleType, through, what: str) -> None:
    item = through.camera if what == "camera" else through
    item.name = "renamed"
    blender.context.view_layer.update()
    assert size(through) == CHOSEN


def test_undo_and_redo(blender: ModuleType, through) -> None:
    bpy = blender
    bpy.ops.ed.undo_push(message="own size")
    bpy.ops.roigs.look_through(photo="photo 2.png")
    bpy.context.view_layer.update()
    second = size(bpy.context.scene)
    bpy.ops.ed.undo_push(message="look through")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    assert bpy.context.scene.camera.name == "photo 1.png"
    assert size(bpy.context.scene) == CHOSEN != second
    bpy.ops.ed.redo()
    bpy.context.view_layer.update()
    assert bpy.context.scene.camera.name == "photo 2.png"
    assert size(bpy.context.scene) == second
    bpy.context.scene.camera = bpy.data.objects["photo 3.png"]
    bpy.context.scene.render.resolution_x = 7
    bpy.context.view_layer.update()
    assert size(bpy.context.scene)[0] != 7
