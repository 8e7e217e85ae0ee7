"""Nothing of the user's is lost: Remove and undo bring back all settings of files of many kinds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.addon.fake_engine import fake
from tests.addon.stage_cases import CODE, flat_floor, own_things, state, write_panorama
from tests.addon.surface_cases import write_ball

pytestmark = pytest.mark.blender

HERE = {"point": (1.5, -1.5, 0.0), "eye": (1.5, -4.0, 3.0)}


def eevee(bpy: ModuleType, scene: Any) -> None:
    """Another engine, a transparent film, and passes that were on."""
    names = [i.identifier for i in type(scene.render).bl_rna.properties["engine"].enum_items]
    scene.render.engine = next(n for n in names if "EEVEE" in n)
    scene.render.film_transparent = scene.render.use_persistent_data = True
    for layer in scene.view_layers:
        layer.cycles.use_pass_shadow_catcher = layer.name == "Extra"


def no_world(bpy: ModuleType, scene: Any) -> None:
    """No world at all, and lamps that are part of what was captured."""
    scene.world = None
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    scene.collection.objects.link(lamp)


def plain_world(bpy: ModuleType, scene: Any) -> None:
    """A world without nodes (before Blender 5), which another scene shares."""
    scene.world = bpy.data.worlds.new("Plain")
    scene.world.color = (0.5, 0.25, 0.125)
    bpy.data.scenes.new("Other").world = scene.world


def no_compositor(bpy: ModuleType, scene: Any) -> None:
    """The user has taken the Gaussians out of the compositor, and switched it off."""
    from roigs_addon.scene import compositor

    for tree in compositor.trees(scene):
        for node in [n for n in tree.nodes if getattr(n, "node_tree", None) is not None]:
            tree.nodes.remove(node)
    scene.render.use_compositing = False
    for layer in scene.view_layers:
        layer.use_pass_z = False


def fresh_compositor(bpy: ModuleType, scene: Any) -> None:
    """Renders without a compositor, as in Blender 5.3 with its own splats."""
    if hasattr(scene, "compositor_effects"):
        scene.compositor_effects.clear()
    elif hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = None
    else:
        scene.node_tree.nodes.clear()
        scene.use_nodes = False
    bpy.data.batch_remove([g for g in bpy.data.node_groups if not g.users])
    bpy.data.batch_remove([i for i in bpy.data.images if i.get("roigs_layer") and not i.users])
    for layer in scene.view_layers:
        layer.use_pass_z = False


def layers_of_its_own(bpy: ModuleType, scene: Any) -> None:
    """Three view layers, one of which leaves the Gaussians out, and one that is not rendered."""
    more = scene.view_layers.new("Third")
    more.use = False
    more.samples, more.use_pass_mist = 7, True
    for child in scene.view_layers["Extra"].layer_collection.children:
        child.exclude = True


FILES: dict[str, Callable[[ModuleType, Any], None]] = {
    each.__name__: each
    for each in (
        eevee,
        no_world,
        plain_world,
        no_compositor,
        fresh_compositor,
        layers_of_its_own,
    )
}


@pytest.fixture
def file(
    request: pytest.FixtureRequest, blender: ModuleType, run, tmp_path: Path, monkeypatch
) -> Any:
    """A scene with a floor of Gaussians, a cube, and settings of the user's."""
    from roigs_addon import settings
    from roigs_engine.formats.splat_ply import write_ply
    from roigs_engine.formats.targets import VIEWERS

    scene, folder = run
    write_ply(folder / "background.ply", flat_floor(), target=VIEWERS)
    blender.ops.roigs.load_results()
    scene.roigs.root.matrix_world.identity()
    scene.render.engine = "CYCLES"
    if request.param in FILES:
        own_things(blender, scene)
        FILES[request.param](blender, scene)
    made, code = tmp_path / "made", CODE
    write_ball(made / "background.glb", radius=0.5)
    write_panorama(blender, made / "panorama.hdr")
    places = ("ARGUMENTS", tmp_path / "arguments"), ("MADE", made), ("RUN", folder)
    for name, path in places:
        code = code.replace(f'"{name}', f'"{path}')
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    blender.ops.mesh.primitive_cube_add(size=0.3, location=(5, 5, 5))
    return scene


@pytest.mark.exact_look
@pytest.mark.parametrize("file", FILES, indirect=True)
def test_remove_brings_back(blender: ModuleType, file: Any) -> None:
    before = state(blender, file)
    assert blender.ops.roigs.stand_here(**HERE) == {"FINISHED"}
    assert blender.ops.roigs.light_from_scene(where="CURSOR") == {"FINISHED"}
    assert state(blender, file) != before
    assert blender.ops.roigs.remove_stage() == {"FINISHED"}
    assert state(blender, file) == before


@pytest.mark.exact_look
@pytest.mark.parametrize("file", FILES, indirect=True)
def test_undo_brings_back(blender: ModuleType, file: Any) -> None:
    before = state(blender, file)
    blender.ops.ed.undo_push(message="before")
    blender.ops.roigs.stand_here(**HERE)
    blender.ops.ed.undo_push(message="Stand Here")
    staged = state(blender, blender.context.scene)
    blender.ops.ed.undo()
    assert state(blender, blender.context.scene) == before
    blender.ops.ed.redo()
    assert state(blender, blender.context.scene) == staged
    blender.ops.roigs.remove_stage()
    assert state(blender, blender.context.scene) == before


@pytest.mark.parametrize("file", ["of Blender 5.3"], indirect=True)
def test_blenders_own_splats_come_back(blender: ModuleType, file: Any) -> None:
    from roigs_addon.scene import display, lookup, native_splats, shadow_pass
    from roigs_addon.ui import stage as panel
    from tests.addon.panels import said

    if not native_splats.exist():
        pytest.skip("this Blender has no splats of its own")
    items, before = lookup.splats(file), state(blender, file)
    assert all(display.is_native(item) for item in items)
    blender.ops.roigs.stand_here(**HERE)
    assert not any(display.is_native(item) for item in items) and shadow_pass.multiplies(file)
    display.show_as(items[0], "GAUSSIANS")
    assert "receive no shadows" in " ".join(said(blender, panel.StagePanel))
    display.show_as(items[0], "EXACT")
    blender.ops.roigs.remove_stage()
    assert all(display.is_native(item) for item in items) and state(blender, file) == before


@pytest.mark.exact_look
@pytest.mark.parametrize("file", ["of Blender 5.3"], indirect=True)
def test_a_scene_of_another_file_is_left_alone(
    blender: ModuleType, file: Any, tmp_path: Path
) -> None:
    """Blender does not save what is changed in it."""
    path, name = tmp_path / "other.blend", file.name
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with blender.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.scenes = [name]
    scene = next(each for each in blender.data.scenes if each.library)
    blender.context.window.scene = scene
    before = state(blender, scene)
    for work in ("catch_shadows", "light_from_scene", "stand_here"):
        with pytest.raises(RuntimeError, match="another file"):
            getattr(blender.ops.roigs, work)()
    assert state(blender, scene) == before
