"""Depth of field, motion blur and orthographic cameras in Blender's own renders."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.pictures import linear, load_rgba, psnr, srgb
from tests.addon.scenes import emitting_plane, through_a_photo

pytestmark = pytest.mark.exact_look


@pytest.fixture
def shot(blender: ModuleType, run, engine, tmp_path: Path):
    """A scene with results, seen through a photo's camera, and a function that renders it."""
    bpy, (scene, _) = blender, run
    render = through_a_photo(bpy, scene)
    render.film_transparent = True

    def f12(samples: int = 1) -> np.ndarray:
        """In linear light, multiplied by alpha."""
        scene.cycles.samples = samples
        render.filepath = str(tmp_path / "f12.png")
        bpy.ops.render.render(write_still=True)
        picture = load_rgba(Path(render.filepath))
        return np.concatenate([linear(picture[..., :3]) * picture[..., 3:], picture[..., 3:]], -1)

    return scene, f12


def emitter(bpy: ModuleType, scene, depth: float, x: float, colour: tuple[float, float, float]):
    """A bright square before the scene's camera, which it faces."""
    from mathutils import Vector

    camera = scene.camera.matrix_world
    plane = emitting_plane(bpy, camera, 0.25 * depth, colour)
    plane.location = camera @ Vector((x * depth, 0, -depth))
    return plane


def alike(a: np.ndarray, b: np.ndarray) -> float:
    return psnr(srgb(a[..., :3]), srgb(b[..., :3]))


def distance(scene) -> float:
    """Of the middle of the box's Gaussians from the camera, along its axis."""
    item = scene.objects["thing Gaussians"]
    corners = [
        scene.camera.matrix_world.inverted() @ item.matrix_world @ v.co for v in item.data.vertices
    ]
    return float(-np.mean([corner.z for corner in corners]))


def test_depth_of_field_is_the_mean_of_pinhole_pictures(blender: ModuleType, shot) -> None:
    """With a mesh in front of the Gaussians, and one behind."""
    bpy, (scene, f12) = blender, shot
    depth, camera = distance(scene), scene.camera
    emitter(bpy, scene, 0.5 * depth, 0.05, (0.1, 0.6, 0.1))
    emitter(bpy, scene, 40 * depth, -0.1, (0.5, 0.1, 0.1))
    sharp = f12()
    data, base = camera.data, camera.matrix_basis.copy()
    data.dof.use_dof, data.dof.focus_distance = True, depth
    radius = 0.03 * depth
    data.dof.aperture_fstop = data.lens * 1e-3 / (2 * radius)
    blurred = f12(samples=64)
    data.dof.use_dof = False
    shift, world = data.shift_x, camera.matrix_world.copy()
    shift_y, pictures = data.shift_y, []
    from mathutils import Matrix

    random = np.random.default_rng(0)
    for k in range(24):
        r, angle = radius * np.sqrt((k + random.random()) / 24), 2.4 * k
        x, y = r * np.cos(angle), r * np.sin(angle)
        camera.matrix_world = world @ Matrix.Translation((x, y, 0))
        data.shift_x = shift - x * data.lens / data.sensor_width / depth
        data.shift_y = shift_y - y * data.lens / data.sensor_width / depth
        pictures.append(f12())
    camera.matrix_basis, data.shift_x, data.shift_y = base, shift, shift_y
    mean = np.mean(pictures, axis=0)
    assert alike(sharp, mean) < 30
    assert alike(blurred, mean) > 38


def test_motion_blur_is_the_mean_over_the_shutters_time(blender: ModuleType, shot) -> None:
    bpy, (scene, f12) = blender, shot
    depth = distance(scene)
    emitter(bpy, scene, 0.6 * depth, 0.15, (0.1, 0.6, 0.1))
    item = scene.objects["thing Gaussians"]
    for frame, x in ((1, 0.0), (3, 0.6)):
        item.location.x = x * depth / 4
        item.keyframe_insert("location", frame=frame)
    scene.frame_set(2)
    still = f12()
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    blurred = f12()
    moved = item.location.copy()
    moved.y += 0.1  # against its keyframe, as before a new one is set
    item.location = moved
    f12()
    with_blur = item.location.copy()
    item.location, scene.render.use_motion_blur = moved, False
    f12()
    assert with_blur == item.location and scene.frame_current == 2
    pictures = []
    for k in range(12):
        time = 1.5 + (k + 0.5) / 12
        scene.frame_set(int(time), subframe=time % 1)
        pictures.append(f12())
    scene.frame_set(2)
    mean = np.mean(pictures, axis=0)
    assert alike(still, mean) < 34
    assert alike(blurred, mean) > 38


def moving(bpy: ModuleType, scene):
    """Have Gaussians move behind a wall; the wall, which hides all of them."""
    depth, item = distance(scene), scene.objects["thing Gaussians"]
    wall = emitter(bpy, scene, 0.3 * depth, 0.0, (0.0, 0.0, 0.0))
    wall.scale = [100] * 3
    for frame, x in ((1, 0.0), (3, 0.15)):
        item.location.x = x * depth
        item.keyframe_insert("location", frame=frame)
    scene.frame_set(2)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    return wall


def test_stretched_time(blender: ModuleType, shot) -> None:
    """Gaussians blur around the frame that Blender shows."""
    from roigs_addon.scene import blur

    bpy, (scene, _) = blender, shot
    item = scene.objects["thing Gaussians"]
    for frame in (0, 400):
        item.location.x = frame
        item.keyframe_insert("location", index=0, frame=frame)
    scene.render.use_motion_blur = True
    scene.render.frame_map_old, scene.render.frame_map_new = 100, 50
    scene.frame_set(80)
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def places(moments) -> np.ndarray:
        return np.array([[m["matrix"] for m in each.request["models"]] for each in moments])

    shown = places([blur.moment(scene, depsgraph)])
    blurred = places(blur.moments(scene, depsgraph))
    assert len(blurred) == blur.MOMENTS and np.ptp(blurred, axis=0).max() > 0.1
    np.testing.assert_allclose(blurred.mean(axis=0), shown[0], atol=1e-3)
    assert scene.frame_current == 80


def test_surfaces_of_a_motion_are_those_of_the_render(blender: ModuleType, shot) -> None:
    """Not those of the viewport, which has hidings of its own."""
    scene, f12 = shot
    wall = moving(blender, scene)
    before = f12()
    assert before[..., :3].max() == 0
    wall.hide_viewport = True
    assert (f12() == before).all()
    wall.hide_viewport = False
    kept = blender.data.collections.new("not rendered")
    scene.collection.children.link(kept)
    kept.objects.link(wall)
    for other in [c for c in wall.users_collection if c is not kept]:
        other.objects.unlink(wall)
    kept.hide_render = True
    assert f12()[..., :3].max() > 0.2


def test_persistent_data_follows_animations_and_edits(blender: ModuleType, shot) -> None:
    """Stepping through the shutter's time does not hide from Cycles what has changed."""
    bpy, (scene, f12) = blender, shot
    moving(bpy, scene).hide_render = True
    depth, render = distance(scene), scene.render
    still, slow = (emitter(bpy, scene, 0.4 * depth, x, (0.1, 0.6, 0.1)) for x in (0.05, -0.05))
    for frame in (1, 3):
        slow.location.z += 0.05 * depth
        slow.keyframe_insert("location", frame=frame)

    def change_frame() -> None:
        scene.frame_set(1)

    def edit() -> None:
        for vertex in still.data.vertices:
            vertex.co *= 2
        still.data.update_tag()

    render.use_persistent_data = True
    before = f12()
    for change in (change_frame, edit):
        change()
        kept = f12()
        assert alike(kept, before) < 40
        render.use_persistent_data = False
        assert (f12() == kept).all()
        render.use_persistent_data = True
        before = f12()


def test_what_is_said_of_rims(blender: ModuleType, shot) -> None:
    """With an opaque film, where meshes are blurred."""
    from roigs_addon import rendering

    bpy, (scene, f12) = blender, shot
    scene.render.film_transparent = False
    camera = scene.camera.data
    emitter(bpy, scene, 2 * distance(scene), 0.0, (0.1, 0.6, 0.1))
    camera.type = "ORTHO"
    f12()
    assert not rendering.problem
    camera.type, camera.dof.use_dof = "PERSP", True
    f12()
    assert "rims" in rendering.problem
    camera.dof.use_dof, scene.render.use_motion_blur = False, True
    f12()
    assert not rendering.problem
    item = scene.objects["thing Gaussians"]
    for frame in (0, 3):
        item.location.x = frame / 10
        item.keyframe_insert("location", frame=frame)
    f12()
    assert "rims" in rendering.problem


def test_without_motion_the_picture_is_the_sharp_one(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    sharp = f12()
    scene.render.use_motion_blur = True
    assert (f12() == sharp).all()


def test_an_orthographic_camera_shows_gaussians_where_meshes_are(blender: ModuleType, shot) -> None:
    bpy, (scene, f12) = blender, shot
    from mathutils import Vector

    depth, camera = distance(scene), scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", depth
    for name in ("Background", "thing Gaussians"):
        scene.objects[name].hide_render = name != "thing Gaussians"
    both = f12()
    assert both[..., 3].max() > 0.9
    item = scene.objects["thing Gaussians"]
    points = np.array([item.matrix_world @ v.co for v in item.data.vertices])
    seen = np.array([camera.matrix_world.inverted() @ Vector(p) for p in points])
    height, width = both.shape[:2]
    place = seen[:, :2] / depth * max(width, height) * [1, -1] + [width / 2, height / 2]
    shift = np.array([-camera.data.shift_x, camera.data.shift_y]) * max(width, height)
    opaque = both[..., 3] > 0.05
    _, columns = np.nonzero(opaque)
    low, high = (place + shift).min(axis=0), (place + shift).max(axis=0)
    assert columns.min() == pytest.approx(max(0, low[0]), abs=6)
    assert columns.max() == pytest.approx(min(width, high[0]), abs=6)
    wall = emitter(bpy, scene, 0.3 * depth, 0.0, (0.0, 0.0, 0.0))
    wall.scale = [100] * 3
    assert f12()[..., :3].max() == 0
    wall.location = camera.matrix_world @ Vector((0, 0, -50 * depth))
    assert alike(f12(), both) > 45


@pytest.mark.parametrize("transparent", [False, True])
def test_a_shadow_catcher_leaves_no_hole(blender: ModuleType, shot, transparent: bool) -> None:
    """Before the Gaussians, where a mesh would hide them."""
    bpy, (scene, f12) = blender, shot
    from roigs_addon import rendering

    scene.render.film_transparent = transparent
    before = f12()
    wall = emitter(bpy, scene, 0.3 * distance(scene), 0.0, (0.0, 0.0, 0.0))
    wall.scale = [100] * 3
    assert alike(f12(), before) < 30
    wall.is_shadow_catcher = True
    caught = f12()
    shown = before[..., 3] > 0.9 if transparent else before[..., :3].sum(-1) > 0.3
    assert psnr(caught[shown], before[shown]) > 30
    assert ("Film" in rendering.problem) == (not transparent)


def test_a_lamp_is_no_shadow_catcher(blender: ModuleType, shot) -> None:
    """Blender marks new lamps as such; a sharp picture is then enough, also with an opaque film."""
    bpy, (scene, f12) = blender, shot
    from roigs_addon import rendering
    from roigs_addon.scene import blur

    scene.render.film_transparent = False
    before = f12()
    bpy.ops.object.light_add(type="SUN")
    assert bpy.context.object.is_shadow_catcher
    assert (f12() == before).all() and not rendering.problem
    assert not blur.moments(scene, bpy.context.evaluated_depsgraph_get())
