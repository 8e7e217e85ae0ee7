"""The first box, in a scene with what a new file of Blender's has in it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.boxes import add_roi
from tests.addon.scenes import imported

pytestmark = pytest.mark.blender


@pytest.fixture
def new_file(blender: ModuleType, addon: ModuleType) -> ModuleType:
    """Blender's start file: a cube that is selected, a camera, a light."""
    blender.ops.wm.read_homefile(use_factory_startup=True, app_template="")
    assert blender.context.scene.objects["Cube"].select_get()
    return blender


def test_it_is_where_the_photos_look(new_file: ModuleType, project: Path) -> None:
    scene = imported(new_file, project)
    roi = add_roi(new_file)
    points = next(o for o in scene.objects if o.roigs.kind == "POINTS")
    world = np.array([points.matrix_world @ v.co for v in points.data.vertices])
    inside = np.abs(world - np.array(roi.matrix_world.translation)) <= np.array(roi.scale)
    assert inside.all(axis=1).mean() > 0.5
    assert max(roi.scale) < 0.7  # the points are within half a metre
    np.testing.assert_allclose(roi.matrix_world.translation, 0, atol=0.2)


def test_the_next_one_is_elsewhere(new_file: ModuleType, project: Path) -> None:
    imported(new_file, project)
    first = add_roi(new_file)
    first.location, first.scale = (0.5, 0, 0), (0.5, 1, 1)
    new_file.context.view_layer.update()
    second = add_roi(new_file)
    assert second.location.x < -0.1


def test_the_start_cube_is_hidden_and_ignored(new_file: ModuleType, project: Path) -> None:
    scene = imported(new_file, project)
    cube = scene.objects["Cube"]
    assert not cube.visible_get() and cube.hide_render
    cube.hide_set(False)  # Alt-H
    assert not cube.visible_get()
    assert not scene.objects["Camera"].hide_get()
    cube.hide_viewport = False
    cube.select_set(True)
    assert max(add_roi(new_file).scale) < 0.7  # around the cube it would be 1.05


@pytest.mark.parametrize("change", ["moved", "edited", "modified", "named"])
def test_a_cube_of_the_users_own_is_not(new_file: ModuleType, project: Path, change: str) -> None:
    scene = new_file.context.scene
    cube = scene.objects["Cube"]
    if change == "moved":
        cube.location.x = 2
    elif change == "edited":
        cube.data.vertices[0].co.x *= 2
    elif change == "modified":
        cube.modifiers.new("Bevel", "BEVEL")
    else:
        cube.name = "mine"
    imported(new_file, project)
    assert cube.visible_get() and not cube.hide_render
    cube.select_set(True)
    new_file.context.view_layer.update()
    np.testing.assert_allclose(min(add_roi(new_file).scale), 1.05, rtol=1e-5)


def test_a_cube_that_is_shown_again_stays_shown(new_file: ModuleType, project: Path) -> None:
    scene = imported(new_file, project)
    scene.objects["Cube"].hide_viewport = False
    imported(new_file, project)
    assert scene.objects["Cube"].visible_get()


def test_a_cursor_that_was_moved_counts(new_file: ModuleType, project: Path) -> None:
    scene = imported(new_file, project)
    scene.cursor.location = 3, 0, 0
    roi = add_roi(new_file)
    np.testing.assert_allclose(roi.matrix_world.translation, (3, 0, 0), atol=1e-6)


def test_without_points_it_is_at_the_cursor(new_file: ModuleType, project: Path) -> None:
    scene = imported(new_file, project)
    for item in [o for o in scene.objects if o.roigs.kind == "POINTS"]:
        new_file.data.objects.remove(item)
    np.testing.assert_allclose(add_roi(new_file).matrix_world.translation, 0, atol=1e-6)
