"""Relight and Take Object: what the engine is asked for, and what the object is made of then."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.fake_engine import fake, in_edit_mode
from tests.addon.panels import said
from tests.addon.stage_cases import write_panorama
from tests.addon.surface_cases import CENTRE, RADIUS, write_ball

pytestmark = pytest.mark.blender

CODE = """
import shutil
from pathlib import Path
Path("ARGUMENTS").write_text(json.dumps(sys.argv[1:]))
given = dict(part[2:].partition("=")[::2] for part in sys.argv if part.startswith("--"))
shutil.copy("PICTURE", given["out"])
say(event="done", outputs={})
"""
LIGHT, DARK, COLOUR = 2.0, 0.5, (160, 120, 60)


@pytest.fixture
def ball(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The mesh of a box, the scene, and the command that the engine was given."""
    from roigs_addon import settings
    from roigs_addon.scene import box_surfaces

    scene, folder = run
    blender.ops.roigs.load_results()
    write_ball(folder / "rois" / "thing.glb", colour=COLOUR)
    item = box_surfaces.show(scene, "thing", folder / "rois" / "thing.glb")
    write_panorama(blender, tmp_path / "light.hdr", high=LIGHT, low=DARK)
    code, arguments = CODE, tmp_path / "arguments"
    for name, path in (("ARGUMENTS", arguments), ("PICTURE", tmp_path / "light.hdr")):
        code = code.replace(f'"{name}"', repr(str(path)))
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    return item, scene, lambda: json.loads(arguments.read_text())


def panel(bpy: ModuleType) -> str:
    from roigs_addon.ui import relight

    return " ".join(said(bpy, relight.RelightPanel))


def captured(item) -> np.ndarray:
    """(V, 3) the light at each vertex, after (V, 3) where it is."""
    from roigs_addon.scene import captured_light
    from roigs_addon.scene.splat_attributes import values

    return values(item.data, captured_light.ATTRIBUTE)[:, :3]


def shown(bpy: ModuleType, scene, item) -> np.ndarray:
    """(H, W, 4) a render of an object alone, from the side, in linear light."""
    from roigs_addon.scene.image_pixels import pixels_of

    for other in list(scene.objects):
        other.hide_render = other != item and other.type != "LIGHT"
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(camera)
    bpy.context.view_layer.update()
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.5 * RADIUS
    middle = item.matrix_world.translation
    camera.location, camera.rotation_euler = (middle.x, middle.y - 2, middle.z), (np.pi / 2, 0, 0)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    render = scene.render
    render.resolution_x = render.resolution_y = 24
    render.resolution_percentage, render.film_transparent = 100, True
    render.use_compositing = False
    render.image_settings.file_format = "OPEN_EXR"
    render.filepath = str(Path(bpy.app.tempdir) / "shown.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(render.filepath, check_existing=False)
    found = pixels_of(image)
    bpy.data.images.remove(image)
    bpy.data.objects.remove(camera)
    return found


def test_the_light_is_drawn_without_the_box_and_stays_at_each_vertex(
    blender: ModuleType, ball
) -> None:
    from mathutils import Matrix

    item, scene, given = ball
    scene.roigs.root.matrix_world = Matrix.Rotation(np.pi / 2, 4, "Y")  # levelled: x is down
    blender.context.view_layer.update()
    item.location.x += 5  # where the object is now does not matter
    assert blender.ops.roigs.relight(name=item.name) == {"FINISHED"}
    arguments = given()
    assert arguments[0] == "panorama" and "--without=thing" in arguments
    listed = json.loads(Path(arguments[1]).read_text())["models"][0]
    assert Path(listed["ply"]).name == "result.ply"
    at = next(part for part in arguments if part.startswith("--at="))[5:].split(",")
    turned = np.array(listed["matrix"])[:3, :3] @ CENTRE
    np.testing.assert_allclose([float(number) for number in at], turned, atol=1e-5)
    light = captured(item)
    from roigs_addon.scene.captured_light import places_of

    high = -(places_of(item.data) - CENTRE)[:, 0] / RADIUS
    assert light[high > 0.9].mean() == pytest.approx(LIGHT, rel=0.1)
    assert light[high < -0.9].mean() == pytest.approx(DARK, rel=0.1)
    assert light[abs(high) < 0.1].mean() == pytest.approx((LIGHT + DARK) / 2, rel=0.1)


def test_a_mesh_in_edit_mode(blender: ModuleType, ball) -> None:
    from roigs_addon.jobs import relight_job

    item, scene, _ = ball
    said = in_edit_mode(item, relight_job.spec(scene, item))
    assert said == "'thing Mesh' is lit by your lamps and world"
    assert len(captured(item)) == len(item.data.vertices)


def test_under_the_captured_light_it_looks_as_captured(blender: ModuleType, ball) -> None:
    from roigs_addon.scene.clouds import to_linear

    item, scene, _ = ball
    blender.ops.roigs.relight(name=item.name)
    texture = to_linear(np.array(COLOUR, np.float32) / 255)
    scene.world = world = blender.data.worlds.new("light")
    if world.node_tree is None:
        world.use_nodes = True
    tree = world.node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = blender.data.images.load(str(Path(scene.roigs.run_dir).parent / "light.hdr"))
    tree.links.new(picture.outputs[0], background.inputs[0])
    inside = slice(9, 15)
    relit = shown(blender, scene, item)[inside, inside, :3].mean(axis=(0, 1))
    np.testing.assert_allclose(relit, texture, rtol=0.1)
    item["Relit"] = 0.0
    item.update_tag()
    as_captured = shown(blender, scene, item)
    np.testing.assert_allclose(
        as_captured[inside, inside, :3].mean(axis=(0, 1)), texture, rtol=0.03
    )
    background.inputs[1].default_value = 0.0
    dark = shown(blender, scene, item)
    np.testing.assert_allclose(dark, as_captured, atol=0.01)  # it shines as captured
    item["Relit"] = 1.0
    item.update_tag()
    assert shown(blender, scene, item)[..., :3].max() < 0.01  # at night


def test_the_panel_has_the_slider_and_takes_it_back(blender: ModuleType, ball) -> None:
    item, _, _ = ball
    own = item.data.materials[0]
    assert "thing Mesh" in panel(blender) and "Relit" not in item
    blender.ops.roigs.relight(name=item.name)
    assert item.material_slots[0].material != own and item.data.materials[0] == own
    assert item["Relit"] == 1.0 and not item.hide_render
    count = len(blender.data.materials)
    blender.ops.roigs.relight(name=item.name)  # again: no second one
    assert len(blender.data.materials) == count
    assert blender.ops.roigs.stop_relight(name=item.name) == {"FINISHED"}
    assert item.material_slots[0].material == own and "Relit" not in item
    assert len(blender.data.materials) == count - 1


def test_a_mesh_that_was_made_again_needs_its_light_again(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces

    item, scene, _ = ball
    blender.ops.roigs.relight(name=item.name)
    assert "made again" not in panel(blender)
    path = Path(scene.roigs.run_dir, "rois", "thing.glb")
    write_ball(path, radius=0.1, colour=COLOUR)
    box_surfaces.show(scene, "thing", path)
    assert "made again: click Relight again" in panel(blender)
    blender.ops.roigs.relight(name=item.name)
    assert "made again" not in panel(blender)


def test_without_a_mesh_or_a_texture_it_says_so(blender: ModuleType, ball) -> None:
    item, _, _ = ball
    with pytest.raises(RuntimeError, match="There is no mesh 'other'"):
        blender.ops.roigs.relight(name="other")
    item.data.materials.clear()
    with pytest.raises(RuntimeError, match="has no picture"):
        blender.ops.roigs.relight(name=item.name)


def test_an_object_is_taken_to_another_file_without_its_run(
    blender: ModuleType, ball, tmp_path: Path
) -> None:
    item, scene, _ = ball
    scene.roigs.root.location = (3.0, 0.0, 1.0)
    blender.context.view_layer.update()
    blender.ops.roigs.relight(name=item.name)
    item["Relit"] = 0.5
    before = {each.name for each in scene.objects}
    gaussians = scene.objects["thing Gaussians"]
    count = len(gaussians.data.vertices)
    assert blender.ops.roigs.take_object(name=item.name) == {"FINISHED"}
    assert {each.name for each in scene.objects} == before and "Asset: thing" in panel(blender)
    asset = blender.data.collections["thing"]
    preview = np.empty(4 * asset.preview.image_size[0] ** 2, np.float32)
    asset.preview.image_pixels_float.foreach_get(preview)
    assert 0.2 < (preview.reshape(-1, 4)[:, 3] > 0).mean() < 0.9
    saved = tmp_path / "taken.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(saved))
    shutil.rmtree(scene.roigs.run_dir)
    blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with blender.data.libraries.load(str(saved), assets_only=True) as (there, wanted):
        assert there.collections == ["thing"]
        wanted.collections = there.collections
    scene = blender.context.scene
    scene.collection.children.link(wanted.collections[0])
    blender.context.view_layer.update()
    assert len(blender.data.objects) == 2 and len(blender.data.scenes) == 1
    mesh, cloud = (
        next(each for each in scene.collection.all_objects if kind in each.name)
        for kind in ("Mesh", "Gaussians")
    )
    assert mesh.parent is None and mesh["Relit"] == 0.5 and not mesh.hide_render
    assert cloud.hide_render and len(cloud.data.vertices) == count
    corners = np.array([mesh.matrix_world @ v.co for v in mesh.data.vertices])
    assert corners[:, 2].min() == pytest.approx(0, abs=1e-5)  # it stands on the ground
    np.testing.assert_allclose(corners[:, :2].mean(axis=0), 0, atol=0.02)
    assert mesh.matrix_world.translation.length < 1e-6  # with its origin there
    from roigs_addon.scene import edits

    cloud.hide_render = False
    assert Path(edits.file_of(cloud)).is_file()  # drawn without the run
    picture = next(
        node for node in mesh.material_slots[0].material.node_tree.nodes if node.type == "TEX_IMAGE"
    )
    assert picture.image.packed_file is not None
    assert all(node.image.packed_file for node in [picture])


@pytest.mark.parametrize("kept", ["action", "strip"])
def test_a_taken_object_stays_at_its_origin_and_keeps_its_look(
    blender: ModuleType, ball, tmp_path: Path, kept: str
) -> None:
    item, scene, _ = ball
    cloud = scene.objects["thing Gaussians"]
    blender.ops.roigs.relight(name=item.name)
    blender.ops.roigs.show_surface(name=item.name, way="BOTH")
    for frame in (1, 10):
        item["Relit"], cloud.roigs.exposure = (1.0, 2.0) if frame == 1 else (0.25, 0.5)
        item.keyframe_insert('["Relit"]', frame=frame)
        cloud.keyframe_insert("roigs.exposure", frame=frame)
        for each in (item, cloud):
            each.location, each.delta_rotation_euler.z = (frame, 0, 0), 0.1 * frame
            each.keyframe_insert("location", frame=frame)
            each.keyframe_insert("delta_rotation_euler", frame=frame)
    cloud.driver_add("scale", 0).driver.expression = "3"
    if kept == "strip":
        for data in (item.animation_data, cloud.animation_data):
            data.nla_tracks.new().strips.new("strip", 1, data.action)
            data.action = None
    scene.frame_set(10)
    before = item.matrix_world.translation.copy()
    blender.ops.roigs.take_object(name=item.name)
    scene.frame_set(1)
    scene.frame_set(10)
    assert (item.matrix_world.translation - before).length < 1e-6  # the original moves
    saved = tmp_path / "taken.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(saved))
    blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender.ops.wm.append(directory=f"{saved}/Collection/", files=[{"name": "thing"}])
    scene = blender.context.scene
    mesh, cloud = (
        next(each for each in scene.objects if each.roigs.kind == kind)
        for kind in ("SURFACE", "SPLATS")
    )
    turns = set()
    for frame, relit, exposure in ((1, 1.0, 2.0), (10, 0.25, 0.5)):
        scene.frame_set(frame)
        assert mesh["Relit"] == pytest.approx(relit)
        assert cloud.roigs.exposure == pytest.approx(exposure)
        for each in (mesh, cloud):
            assert each.matrix_world.translation.length < 1e-6
            turns.add(tuple(round(angle, 4) for angle in each.matrix_world.to_euler()))
    assert len(turns) == 1


def test_hidden_gaussians_are_taken_from_where_the_scene_is_now(blender: ModuleType, ball) -> None:
    item, scene, _ = ball
    assert scene.objects["thing Gaussians"].hide_viewport
    blender.ops.roigs.take_object(name=item.name)
    scene.roigs.root.location = (3.0, 0.0, 1.0)
    blender.context.view_layer.update()
    blender.ops.roigs.take_object(name=item.name)
    taken = [blender.data.collections[name].objects for name in ("thing", "thing.001")]
    middles = [
        np.mean([each.matrix_world @ vertex.co for vertex in each.data.vertices], axis=0)
        for items in taken
        for each in sorted(items, key=lambda each: each.roigs.kind)
    ]
    np.testing.assert_allclose(middles[:2], middles[2:], atol=1e-4)


def test_what_an_object_stood_on_stays(blender: ModuleType, ball) -> None:
    import bmesh
    from mathutils import Matrix

    item, scene, _ = ball
    scene.roigs.root.matrix_world = Matrix()  # z is up in the mesh, too
    blender.context.view_layer.update()
    plate = bmesh.new()
    plate.from_mesh(item.data)
    low = min(vertex.co.z for vertex in plate.verts)
    corners = [
        plate.verts.new((x * 0.3, y * 0.3, low)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    plate.faces.new(corners)
    high = max(vertex.co.z for vertex in plate.verts)
    wave = low + 0.05 * (high - low)  # of the plate's edge, loose once that is cut off
    plate.faces.new([plate.verts.new((x, y, wave)) for x, y in ((0.2, 0), (0.25, 0), (0.2, 0.05))])
    plate.to_mesh(item.data)
    plate.free()
    count = len(item.data.vertices)
    blender.ops.roigs.take_object(name=item.name)
    taken = next(each for each in blender.data.collections["thing"].objects if "Mesh" in each.name)
    assert len(item.data.vertices) == count
    places = np.array([taken.matrix_world @ vertex.co for vertex in taken.data.vertices])
    assert len(places) < count - 7 and np.ptp(places, axis=0).max() < 2.1 * RADIUS
    assert places[:, 2].min() == pytest.approx(0, abs=1e-6)
