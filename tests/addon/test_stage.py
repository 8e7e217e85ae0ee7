"""Light From Scene, Catch Shadows, Remove: what the engine is asked for, what the scene gets."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.fake_engine import LISTEN, fake, until, use
from tests.addon.panels import said
from tests.addon.splat_cases import random_ply
from tests.addon.stage_cases import CODE, own_things, state, write_panorama
from tests.addon.surface_cases import write_ball

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]


@pytest.fixture
def made(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A scene with results and things of its own, its run folder, and the commands given."""
    from roigs_addon import settings

    scene, folder = run
    blender.ops.roigs.load_results()
    scene.render.engine = "CYCLES"
    own_things(blender, scene)
    write_ball(tmp_path / "made" / "background.glb", radius=2.0)
    write_panorama(blender, tmp_path / "made" / "panorama.hdr", high=3.0)
    code, arguments = CODE, tmp_path / "arguments"
    for name, path in (("ARGUMENTS", arguments), ("MADE", tmp_path / "made"), ("RUN", folder)):
        code = code.replace(f'"{name}', f'"{path}')
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    return (
        scene,
        folder,
        lambda: [json.loads(line) for line in arguments.read_text().splitlines()],
    )


def panel(bpy: ModuleType) -> str:
    from roigs_addon.ui import stage

    return " ".join(said(bpy, stage.StagePanel))


def looked_at(socket):
    """The node that a socket is linked from."""
    return socket.links[0].from_node


def test_light_is_asked_for_in_the_models_frame(blender: ModuleType, made) -> None:
    scene, folder, given = made
    root = scene.roigs.root
    root.scale, root.location = (2, 2, 2), (1, 2, 3)
    blender.context.view_layer.update()
    scene.cursor.location = (3, 4, 7)
    assert blender.ops.roigs.light_from_scene(where="CURSOR") == {"FINISHED"}
    (command,) = given()
    assert command[:2] == ["panorama", str(folder / "blender/panorama.json")]
    models = json.loads((folder / "blender/panorama.json").read_text())["models"]
    assert len(models) == 2 and np.array(models[0]["matrix"]) == pytest.approx(np.eye(4), abs=1e-6)
    at = next(part for part in command if part.startswith("--at=")).removeprefix("--at=")
    expected = np.linalg.inv(np.array(root.matrix_world)) @ (3, 4, 7, 1)
    assert [float(number) for number in at.split(",")] == pytest.approx(expected[:3].tolist())
    assert {"--width=1024", "--device"} <= set(command)
    assert scene.roigs.stage.here.parent == root
    blender.context.view_layer.update()
    assert list(scene.roigs.stage.here.matrix_world.translation) == pytest.approx([3, 4, 7])
    assert "The world has" in panel(blender)


def test_light_from_a_hidden_box_that_has_moved(blender: ModuleType, made) -> None:
    scene, _, given = made
    box, root = scene.objects["thing"], scene.roigs.root
    inside = box.matrix_world.translation.copy()
    box.hide_viewport = True
    blender.context.view_layer.update()
    root.scale, root.location = (2, 2, 2), (1, 2, 3)
    blender.context.view_layer.update()
    assert blender.ops.roigs.light_from_scene(where="BOX") == {"FINISHED"}
    at = next(part for part in given()[0] if part.startswith("--at=")).removeprefix("--at=")
    assert [float(number) for number in at.split(",")] == pytest.approx(list(inside), abs=1e-6)
    assert list(scene.roigs.stage.here.location) == pytest.approx(list(inside), abs=1e-6)


def test_mirrors_and_glass_see_a_picture_of_their_own(blender: ModuleType, made) -> None:
    scene, _, _ = made
    image, mirror = (blender.data.images.new(name, 8, 4) for name in ("light", "mirror"))
    from mathutils import Vector

    from roigs_addon.scene import stage_world

    stage_world.shine(scene, image, None, Vector(), mirror)
    nodes = scene.world.node_tree.nodes
    choice = next(
        n for n in nodes if n.type == "MIX_SHADER" and looked_at(n.inputs[0]).type == "MATH"
    )
    factor, matt, clear = choice.inputs
    sockets = {
        link.from_socket.name for socket in looked_at(factor).inputs for link in socket.links
    }
    assert sockets == {"Is Glossy Ray", "Is Transmission Ray"}

    def picture(socket):
        """The picture that a shader shows, through its factor of highlights."""
        return looked_at(
            looked_at(looked_at(looked_at(socket).inputs["Color"]).inputs[0]).inputs[0]
        )

    assert picture(matt).image == image and picture(clear).image == mirror
    assert looked_at(picture(matt).inputs["Vector"]) == looked_at(picture(clear).inputs["Vector"])
    assert stage_world.picture(scene) == image


def test_the_camera_sees_the_users_world(blender: ModuleType, made) -> None:
    scene, _, _ = made
    blender.ops.roigs.light_from_scene(where="CURSOR")
    output = next(n for n in scene.world.node_tree.nodes if n.type == "OUTPUT_WORLD")
    choice = looked_at(output.inputs["Surface"])
    assert looked_at(choice.inputs[0]).type == "LIGHT_PATH"
    assert tuple(looked_at(choice.inputs[2]).inputs[0].default_value)[:3] == pytest.approx(
        (0.2, 0.4, 0.8)
    )
    shining = [n for n in scene.world.node_tree.nodes if n.type == "TEX_ENVIRONMENT"]
    (picture,) = shining
    assert picture.image.packed_file is not None
    assert scene.roigs.stage.world_before.name == "Mine"


def test_lit_again_keeps_the_users_settings(blender: ModuleType, made) -> None:
    from roigs_addon.scene import stage_world

    scene, _, _ = made
    blender.ops.roigs.light_from_scene(where="CURSOR")
    stage_world.value(scene.world, "Highlights").default_value = 2.5
    blender.ops.roigs.light_from_scene(where="CURSOR")
    assert stage_world.value(scene.world, "Highlights").default_value == 2.5
    assert scene.roigs.stage.world_before.name == "Mine"
    assert len([w for w in blender.data.worlds if w.name.startswith("ROI-GS")]) == 1


def test_shadows_need_the_engine_once(blender: ModuleType, made) -> None:
    from roigs_addon.scene import proxies, shadow_pass

    scene, folder, given = made
    write_ball(folder / "rois" / "thing.glb")
    blender.ops.roigs.load_results()
    assert blender.ops.roigs.catch_shadows() == {"FINISHED"}
    (command,) = given()
    assert command[:3] == ["surface", str(folder), "--background"]
    names = sorted(item.name for item in proxies.of_scene(scene))
    assert names == ["Background Proxy", "thing Proxy"]
    assert all(item.is_shadow_catcher and item.hide_viewport for item in proxies.of_scene(scene))
    assert shadow_pass.multiplies(scene) and scene.roigs.stage.catches
    assert blender.ops.roigs.catch_shadows() == {"FINISHED"}
    assert len(given()) == 1 and len(proxies.of_scene(scene)) == 2
    scene.roigs.stage.reflects = False
    assert not any(item.visible_glossy or item.visible_shadow for item in proxies.of_scene(scene))
    blender.ops.roigs.catch_shadows()
    assert scene.roigs.stage.catches and not scene.roigs.stage.reflects


def test_what_does_not_move_costs_frames_little(blender: ModuleType, made) -> None:
    from roigs_addon.scene import proxies

    scene, _, _ = made
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.ops.roigs.catch_shadows()
    assert scene.render.use_persistent_data  # proxies are built once
    assert scene.world.cycles.sampling_method == "MANUAL"
    assert scene.world.cycles.sample_map_resolution == 32  # the picture's width
    (proxy,) = proxies.of_scene(scene)
    assert {slot.material.cycles.emission_sampling for slot in proxy.material_slots} == {"NONE"}


def test_only_cameras_and_mirrors_see_what_is_far(
    blender: ModuleType, made, tmp_path: Path
) -> None:
    """Rays that are let through by a whole room are slow; mirrors see all of it."""
    from roigs_addon.scene import proxies
    from roigs_addon.stage_properties import CLEAR, RAYS

    scene, _, _ = made
    write_ball(tmp_path / "made" / "background.glb", radius=2.0)
    blender.ops.roigs.catch_shadows()
    (near,) = proxies.of_scene(scene)
    (far,) = near.children
    assert far.visible_camera
    assert [name for name in RAYS if getattr(far, f"visible_{name}")] == list(CLEAR)

    def sizes() -> list[int]:
        blender.context.view_layer.update()
        graph = blender.context.evaluated_depsgraph_get()
        for item in (near, far):  # hidden in the viewport, which leaves modifiers out
            item.hide_viewport = False
        graph.update()
        return [len(item.evaluated_get(graph).data.polygons) for item in (near, far)]

    every = len(near.data.polygons)
    scene.roigs.stage.here.location = (0, 0, 0)
    proxies.set_reach(scene, 1.0)
    assert sizes() == [every, 0], "8 units"
    proxies.set_reach(scene, 0.01)
    assert sizes() == [0, every], "8 hundredths, and the ball is far from there"
    scene.roigs.stage.here.location = near.data.vertices[0].co
    proxies.set_reach(scene, 0.01)
    few, most = sizes()
    assert 0 < few < every / 2 and few + most >= every
    assert blender.ops.roigs.remove_stage() == {"FINISHED"}
    assert not [item for item in blender.data.objects if "Proxy" in item.name]


def test_near_is_what_is_near_a_box_or_its_mesh(blender: ModuleType, made) -> None:
    """Without boxes in the file, proxies of a whole room would shine, and shade one another."""
    from roigs_addon.scene import lookup

    scene, folder, _ = made
    write_ball(folder / "rois" / "thing.glb", radius=0.25)
    blender.ops.roigs.load_results()
    for box in lookup.rois(scene):
        blender.data.objects.remove(box)
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.context.view_layer.update()
    size = scene.roigs.stage.here.matrix_world.to_scale()
    assert list(size) == pytest.approx(3 * [8 * 0.25], rel=0.02)


def test_a_box_without_a_mesh_is_named(blender: ModuleType, made) -> None:
    blender.ops.roigs.catch_shadows()
    assert "No mesh of thing" in panel(blender)


def test_a_box_that_is_shown_as_a_mesh_does_not_catch(blender: ModuleType, made) -> None:
    """Its proxy would hide it: both are in the same place."""
    from roigs_addon import rendering
    from roigs_addon.scene import box_surfaces

    scene, folder, _ = made
    write_ball(folder / "rois" / "thing.glb")
    blender.ops.roigs.load_results()
    blender.ops.roigs.catch_shadows()
    mesh, proxy = box_surfaces.surface_of(scene, "thing"), scene.objects["thing Proxy"]
    assert not proxy.hide_render
    for way, hidden in (("MESH", True), ("GAUSSIANS", False), ("BOTH", True)):
        box_surfaces.set_way(scene, mesh, way)
        rendering.before_frame(scene)
        assert proxy.hide_render == hidden, way
    blender.ops.roigs.catch_shadows()
    assert scene.objects["thing Proxy"].hide_render


def test_remove_brings_all_back(blender: ModuleType, made) -> None:
    scene, folder, _ = made
    write_ball(folder / "rois" / "thing.glb")
    blender.ops.roigs.load_results()
    before = state(blender, scene)
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.ops.roigs.catch_shadows()
    assert state(blender, scene) != before
    assert blender.ops.roigs.remove_stage() == {"FINISHED"}
    assert state(blender, scene) == before
    with pytest.raises(RuntimeError, match="There is none"):
        blender.ops.roigs.remove_stage()


def test_what_the_user_put_beside_stays(blender: ModuleType, made) -> None:
    """In the collection of the additions, and in one below it."""
    scene, _, _ = made
    before = set(blender.data.objects)
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.ops.roigs.catch_shadows()
    own = scene.roigs.stage.collection
    vase, cup, lamp = (blender.data.objects.new(name, None) for name in ("vase", "cup", "lamp"))
    below, both = (blender.data.collections.new(name) for name in ("below", "both"))
    for collection, items in ((own, (vase, lamp)), (below, (cup,)), (both, (lamp,))):
        for item in items:
            collection.objects.link(item)
    for child in (below, both):
        own.children.link(child)
    scene.collection.children.link(both)
    blender.context.view_layer.update()
    vase.hide_set(True)
    scene.roigs.stage.catches = scene.roigs.stage.reflects = False
    assert vase.visible_camera and vase.visible_glossy
    assert blender.ops.roigs.remove_stage() == {"FINISHED"}
    assert set(blender.data.objects) == before | {vase, cup, lamp}
    assert list(vase.users_collection) == [scene.collection] and vase.hide_get()
    assert list(lamp.users_collection) == [both] and list(cup.users_collection) == [below]
    assert {below, both} <= set(scene.collection.children)


def test_lamps_shine_on_captured_things(blender: ModuleType, made) -> None:
    from roigs_addon.scene import stage

    scene, _, _ = made
    lamp = blender.data.objects.new("lamp", blender.data.lights.new("lamp", "POINT"))
    scene.collection.objects.link(lamp)
    assert lamp.is_shadow_catcher
    blender.ops.roigs.catch_shadows()
    assert not lamp.is_shadow_catcher
    lamp.is_shadow_catcher = True
    stage.free_lamps(scene)
    assert lamp.is_shadow_catcher, "the user's choice"
    lamp.is_shadow_catcher = False
    blender.ops.roigs.remove_stage()
    assert lamp.is_shadow_catcher and not lamp.keys()


def test_what_the_user_changed_since_stays(blender: ModuleType, made) -> None:
    scene, _, _ = made
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.ops.roigs.catch_shadows()
    scene.world = blender.data.worlds.new("Later")
    assert "another world" in panel(blender)
    blender.ops.roigs.remove_stage()
    assert scene.world.name == "Later" and "Mine" in blender.data.worlds


def test_it_is_in_the_file(blender: ModuleType, made, tmp_path: Path) -> None:
    from roigs_addon.scene import proxies, shadow_pass

    scene, folder, _ = made
    before = state(blender, scene)
    blender.ops.roigs.light_from_scene(where="CURSOR")
    blender.ops.roigs.catch_shadows()
    path = tmp_path / "elsewhere" / "scene.blend"
    path.parent.mkdir()
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    shutil.rmtree(folder / "blender")
    blender.ops.wm.open_mainfile(filepath=str(path))
    scene = blender.context.scene
    picture = next(n for n in scene.world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").image
    assert picture.packed_file is not None and picture.pixels[4 * 32 * 15] == pytest.approx(3.0)
    assert len(proxies.of_scene(scene)) == 1 and shadow_pass.multiplies(scene)
    blender.ops.roigs.remove_stage()
    assert state(blender, scene) == before


def test_it_stops_without_a_trace(
    blender: ModuleType, made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mathutils import Vector

    from roigs_addon import settings
    from roigs_addon.jobs import current, stage_job

    scene, _, _ = made
    before = state(blender, scene)
    use(monkeypatch, tmp_path / "slow", LISTEN)
    wanted = stage_job.Wanted(light=Vector(), shadows=True)
    job = current.start(settings.engine(()), stage_job.spec(scene, wanted))
    assert until(lambda: job.poll() and job.state.stage == "scene")
    job.stop()
    assert until(lambda: not job.poll())
    assert job.result.stopped and state(blender, scene) == before


def test_blenders_own_splats_become_exact_meanwhile(
    blender: ModuleType, made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import display, splats

    scene, _, _ = made
    monkeypatch.setattr(display, "is_native", lambda item, **_: item.roigs.shown_as == "GAUSSIANS")
    items = [item for item in scene.objects if item.roigs.kind == "SPLATS"]
    assert {item.roigs.shown_as for item in items} == {"GAUSSIANS"}
    monkeypatch.setattr(display, "refresh", lambda item: None)
    blender.ops.roigs.catch_shadows()
    assert {item.roigs.shown_as for item in items} == {"EXACT"}
    items[0].name = "renamed"
    new = splats.show_imported(scene, random_ply(tmp_path / "new.ply", 9), "new", in_model=False)
    assert new.roigs.shown_as == "EXACT"
    items.append(new)
    blender.ops.roigs.remove_stage()
    assert {item.roigs.shown_as for item in items} == {"GAUSSIANS"}
