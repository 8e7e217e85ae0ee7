"""Shadows on captured things, and captured things in mirrors: small renders with Cycles."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import VIEWERS
from tests.addon.pictures import linear, load_rgba
from tests.addon.scenes import through_a_photo
from tests.addon.stage_cases import flat_floor, write_panorama
from tests.addon.surface_cases import write_ball

pytestmark = pytest.mark.exact_look
SIDE = 64


@pytest.fixture
def shot(blender: ModuleType, run, engine, tmp_path: Path):
    """A floor of Gaussians that catches, a light above it, and what renders it from above."""
    from mathutils import Vector

    from roigs_addon.jobs import stage_job
    from roigs_addon.scene import proxies, stage, stage_world

    bpy, (scene, folder) = blender, run
    write_ply(folder / "background.ply", flat_floor(), target=VIEWERS)
    render = through_a_photo(bpy, scene)
    camera = bpy.data.objects.new("above", bpy.data.cameras.new("above"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0, -2.2, 2.2), (np.pi / 4, 0, 0)
    scene.camera = camera
    render.resolution_x = render.resolution_y = SIDE
    scene.cycles.samples, scene.cycles.seed = 32, 1
    picture = tmp_path / "panorama.hdr"
    write_panorama(bpy, picture)
    image = stage_job.read_picture(picture)
    stage_world.shine(scene, image, scene.roigs.root, Vector((0, 0, 0.5)))
    proxies.plane(scene, Vector((0, 0, 0)), Vector((0, 0, 1)), 6.0)
    proxies.use_light(scene, image)
    stage.multiply(scene)

    def f12(name: str) -> np.ndarray:
        """(H, W, 4) in linear light."""
        render.filepath = str(tmp_path / f"{name}.png")
        bpy.ops.render.render(write_still=True)
        found = load_rgba(Path(render.filepath))
        return np.concatenate([linear(found[..., :3]), found[..., 3:]], axis=-1)

    return scene, f12


def ball(bpy: ModuleType, height: float, colour: tuple[float, float, float], *, mirror: bool):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.4, location=(0, 0, height))
    item = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("ball")
    if material.node_tree is None:
        material.use_nodes = True
    made = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    made.inputs["Base Color"].default_value = (*colour, 1.0)
    made.inputs["Metallic"].default_value = float(mirror)
    made.inputs["Roughness"].default_value = 0.0 if mirror else 1.0
    item.data.materials.append(material)
    return item


@pytest.mark.parametrize("transparent", [True, False])
def test_a_ball_darkens_what_is_below_it(blender: ModuleType, shot, transparent: bool) -> None:
    scene, f12 = shot
    scene.render.film_transparent = transparent
    item = ball(blender, 0.4, (0.1, 0.1, 0.1), mirror=False)
    item.hide_render = True
    without = f12("without")
    item.hide_render = False
    with_it = f12("with")
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    def ratio(x: float, y: float) -> float:
        """Of the picture at a place on the plane, with the ball and without."""
        place = world_to_camera_view(scene, scene.camera, Vector((x, y, 0.0)))
        column, row = int(place.x * SIDE), int((1 - place.y) * SIDE)
        part = np.s_[row - 1 : row + 2, column - 1 : column + 2, :3]
        return float(with_it[part].mean() / without[part].mean())

    assert ratio(0.0, -0.22) < 0.6, "beside the contact"
    assert ratio(0.9, 0.5) == pytest.approx(1.0, abs=0.12), "far from it"
    place = world_to_camera_view(scene, scene.camera, Vector((0, 0, 0.8)))
    seen = with_it[int((1 - place.y) * SIDE) + 4, int(place.x * SIDE)]
    assert seen[3] == 1 and 0.02 < seen[:3].mean() < 0.4, "the world lights it"


def test_a_lamp_brightens_captured_things(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    dark = f12("dark")
    lamp = blender.data.lights.new("lamp", "POINT")
    lamp.energy = 100.0
    item = blender.data.objects.new("lamp", lamp)
    item.is_shadow_catcher = False
    scene.collection.objects.link(item)
    item.location = (0, 0, 1)
    lit = f12("lit")
    middle = np.s_[SIDE // 2 - 4 : SIDE // 2 + 4, SIDE // 2 - 4 : SIDE // 2 + 4, :3]
    assert lit[middle].mean() > 1.3 * dark[middle].mean()


def test_a_mirror_shows_the_captured_room(blender: ModuleType, shot, tmp_path: Path) -> None:
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from roigs_addon.scene import proxies

    scene, f12 = shot
    path = tmp_path / "background.glb"
    write_ball(path, radius=4.0, colour=(220, 20, 20))
    item = ball(blender, 0.6, (1, 1, 1), mirror=True)
    blue = f12("without the room")
    proxies.bring(scene, path)
    proxies.set_reach(scene, 1.0)
    red = f12("with the room")
    place = world_to_camera_view(scene, scene.camera, Vector((0, -0.1, 0.95)))
    row, column = int((1 - place.y) * SIDE), int(place.x * SIDE)
    middle = np.s_[row - 1 : row + 3, column - 3 : column + 3]
    assert item.name in scene.objects and red[middle][..., 3].min() == 1
    seen = red[middle].mean(axis=(0, 1))
    assert seen[0] > 5 * seen[1] and blue[middle][..., 0].mean() < 2 * blue[middle][..., 1].mean()
    scene.roigs.stage.reflects = False
    grey = f12("not reflected")[middle].mean(axis=(0, 1))
    assert grey[0] < 2 * grey[1]


def test_what_it_stands_on_does_not_lie_over_its_foot(blender: ModuleType, shot) -> None:
    """Gaussians some millimetres above it are those of the table, not something in front."""
    scene, f12 = shot
    (floor,) = (i for i in scene.objects if i.name.startswith("Plane Proxy"))
    floor.location.z = -0.2
    item = ball(blender, -0.45, (1.0, 0.0, 0.0), mirror=False)  # its top is 5 cm below the floor
    item.scale = 3 * [0.98]
    middle = np.s_[SIDE // 2 - 2 : SIDE // 2 + 2, SIDE // 2 - 2 : SIDE // 2 + 2]
    seen = []
    for radius in (0.0, 0.6):
        scene.roigs.stage.radius = radius
        red, green, *_ = f12(f"{radius}")[middle].mean(axis=(0, 1))
        seen.append(red > 2 * green)
    assert seen == [False, True]


def test_its_rim_is_smooth(blender: ModuleType, shot) -> None:
    """Pixels that it covers in part show it and what is behind it."""
    scene, f12 = shot
    scene.roigs.stage.radius = 0.4
    item = ball(blender, 0.5, (1.0, 0.0, 0.0), mirror=False)
    item.scale = 3 * [0.7]
    picture = f12("rim")
    share = np.clip((picture[..., 0] - picture[..., 1]) / picture[..., 0].max(), 0, 1)
    whole = share > 0.6 * share.max()
    beside = whole.copy()
    for axis in (0, 1):
        beside |= np.roll(whole, 1, axis) | np.roll(whole, -1, axis)
    beside &= ~whole
    assert np.mean(share[beside] > 0.3 * share.max()) > 0.6, "else it ends with whole pixels"


def test_other_engines_show_what_was_captured(blender: ModuleType, shot) -> None:
    """They have no shadow catchers: no proxies, no pass to multiply by; then Cycles again."""
    from roigs_addon.scene import proxies

    scene, f12 = shot
    before = f12("cycles")[SIDE // 2 :, :, :3]
    scene.render.engine = "BLENDER_WORKBENCH"
    found = f12("workbench")[SIDE // 2 :, :, :3]
    assert np.median(found) == pytest.approx(np.median(before), rel=0.1) and np.median(found) > 0.1
    scene.render.engine = "CYCLES"
    assert f12("again")[SIDE // 2 :, :, :3] == pytest.approx(before, abs=0.02)
    assert not any(item.hide_render for item in proxies.of_scene(scene))
