"""Place of a camera's picture in a viewport."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

import pytest
from numpy.testing import assert_allclose

SIZE = (800, 500)


@pytest.fixture
def view(blender: ModuleType) -> SimpleNamespace:
    """A context of a viewport, with an active camera."""
    # The empty factory file has screens, in background mode too.
    space = next(
        area.spaces.active
        for screen in blender.data.screens
        for area in screen.areas
        if area.type == "VIEW_3D"
    )
    scene = blender.context.scene
    for name in ("A", "B"):
        camera = blender.data.objects.new(name, blender.data.cameras.new(name))
        scene.collection.objects.link(camera)
    scene.camera = space.camera = blender.data.objects["A"]
    scene.render.resolution_x, scene.render.resolution_y = 640, 480
    space.region_3d.view_perspective = "CAMERA"
    return SimpleNamespace(space_data=space, region_data=space.region_3d, scene=scene)


def window_matrix(blender: ModuleType, camera: object, place: tuple[float, ...]) -> object:
    """Clip space of a window where the camera's picture has that centre and those half sides."""
    from mathutils import Matrix

    graph = blender.context.evaluated_depsgraph_get()
    picture = camera.evaluated_get(graph).calc_matrix_camera(graph, x=640, y=480)
    x, y, width, height = place
    moved = Matrix.Diagonal((width, height, 1, 1))
    moved[0][3], moved[1][3] = x, y
    return moved @ picture


def test_the_frame_is_where_the_window_shows_the_picture(
    blender: ModuleType, view: SimpleNamespace
) -> None:
    from roigs_addon.viewport.view import camera_frame

    camera = view.scene.camera
    camera.data.lens, camera.data.shift_x, camera.data.shift_y = 35.0, 0.11, -0.07
    camera.scale = (2.0, 2.0, 2.0)
    projection = window_matrix(blender, camera, (0.25, -0.5, 0.5, 0.2))
    found = camera_frame(view, projection, SIZE)
    assert_allclose(found, (300, 75, 700, 175), atol=0.05)


def test_the_local_camera_of_a_view(blender: ModuleType, view: SimpleNamespace) -> None:
    from roigs_addon.viewport.view import camera_frame

    other = blender.data.objects["B"]
    other.data.lens = 80.0
    view.space_data.use_local_camera, view.space_data.camera = True, other
    projection = window_matrix(blender, other, (0.0, 0.0, 1.0, 1.0))
    assert_allclose(camera_frame(view, projection, SIZE), (0, 0, 800, 500), atol=0.05)


@pytest.mark.parametrize("kind", ["free", "quarter", "no camera", "empty", "orthographic"])
def test_other_views_are_frames_as_a_whole(
    blender: ModuleType, view: SimpleNamespace, kind: str
) -> None:
    from roigs_addon.viewport.view import camera_frame

    projection = window_matrix(blender, view.scene.camera, (0.25, -0.5, 0.5, 0.2))
    if kind == "free":
        view.space_data.region_3d.view_perspective = "PERSP"
    elif kind == "quarter":  # of a quad view, beside the one through the camera
        view.region_data = SimpleNamespace(view_perspective="ORTHO")
    elif kind == "no camera":
        view.scene.camera = None
    elif kind == "empty":
        view.scene.camera = blender.data.objects.new("Empty", None)
    else:
        view.scene.camera.data.type = "ORTHO"
    assert camera_frame(view, projection, SIZE) == (0, 0, 800, 500)
