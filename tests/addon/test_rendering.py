"""Gaussians in Blender's own renders: F12 and animations, with Cycles."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests import warm_engine
from tests.addon.levels_cases import FAR, make_levels
from tests.addon.pictures import linear, load_png, load_rgba, psnr, srgb
from tests.addon.scenes import command_line, emitting_plane, through_a_photo
from tests.addon.splat_cases import recoloured

pytestmark = pytest.mark.exact_look


@pytest.fixture
def shot(blender: ModuleType, run, engine, tmp_path: Path):
    """A scene with results, seen through a photo's camera, and a function that renders it."""
    bpy, (scene, _) = blender, run
    render = through_a_photo(bpy, scene)

    def f12(name: str = "f12") -> np.ndarray:
        render.filepath = str(tmp_path / f"{name}.png")
        bpy.ops.render.render(write_still=True)
        return load_rgba(Path(render.filepath))

    return scene, f12


def only(scene, name: str) -> None:
    """Have renders show one of the Gaussian objects."""
    for item in scene.objects:
        if item.roigs.kind == "SPLATS":
            item.hide_render = item.name != name


def engines(engine, scene, ply: Path, out: Path) -> np.ndarray:
    """The engine's picture of a PLY through photo 3; its process starts at once."""
    arguments = ["--scene", scene.roigs.colmap, "--name", "photo 3.png", "--out", out]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(engine), "command", warm_engine.quick(type(engine).command))
        command_line(engine, "render", ply, *arguments)
    (picture,) = out.rglob("*.png")
    return load_png(picture)


@pytest.mark.cold
def test_f12_is_the_engines_picture(blender: ModuleType, run, shot, engine, tmp_path: Path) -> None:
    scene, f12 = shot
    only(scene, "Background")
    mine = f12()
    own = engines(engine, scene, run[1] / "background.ply", tmp_path / "own")
    assert own.std() > 0.01
    assert psnr(mine[..., :3] * mine[..., 3:], own) > 40


def test_a_moved_world_gives_the_same_picture(blender: ModuleType, shot) -> None:
    """Camera and Gaussians are below the root."""
    scene, f12 = shot
    before = f12()
    root = scene.roigs.root
    root.scale, root.location = (2, 2, 2), (1, 2, 3)
    root.rotation_quaternion = (0.5, 0.5, 0.5, 0.5)
    assert psnr(f12("moved"), before) > 40


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_millimetres_and_kilometres(
    blender: ModuleType, shot, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a scene of that size, pictures are the same, and meshes cover by depth as before."""
    bpy, (scene, f12) = blender, shot
    from roigs_addon.scene import placement

    monkeypatch.setattr(placement, "keep", lambda scene: Path(scene.roigs.colmap))  # shared folder
    before = f12()
    bpy.ops.roigs.set_scale(first=(0, 0, 0), second=(0, 0, 1), length=factor)
    assert psnr(f12("scaled"), before) > 40
    camera = scene.camera.matrix_world
    plane = black_plane(bpy, scene.camera.matrix_world)
    plane.scale = [factor] * 3
    plane.location = camera @ (bpy_vector(0, 0, -0.05))
    assert f12("in front")[..., :3].max() == 0
    plane.location = camera @ (bpy_vector(0, 0, -90))
    behind = f12("behind")
    assert behind[..., 3].min() == 1, "the camera clips what is behind"
    assert behind[..., :3].max() > 0.2


def test_what_is_hidden_moved_or_coarse_is_seen(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    whole = f12()
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    coarse = f12("coarse")
    assert psnr(coarse, whole) < 40
    only(scene, "nothing")
    assert f12("nothing")[..., 3].max() == 0
    only(scene, "Background")
    alone = f12("alone")
    scene.objects["Background"].location.x += 0.3
    assert psnr(f12("shifted"), alone) < 35


def test_edits_are_rendered(blender: ModuleType, run, shot, engine, tmp_path: Path) -> None:
    scene, f12 = shot
    only(scene, "Background")
    item = scene.objects["Background"]
    arrays = read_ply(run[1] / "background.ply")
    whole = f12()
    edit = bmesh_of(item)
    bmesh_delete(edit, arrays["means"][:, 0] > 0)
    edit.to_mesh(item.data)
    kept = {name: values[arrays["means"][:, 0] <= 0] for name, values in arrays.items()}
    write_ply(tmp_path / "kept.ply", kept)
    own = engines(engine, scene, tmp_path / "kept.ply", tmp_path / "own")
    mine = f12("edited")
    assert psnr(mine, whole) < 40
    assert psnr(mine[..., :3] * mine[..., 3:], own) > 40


def test_levels_of_detail_are_rendered(
    blender: ModuleType, run, shot, engine, tmp_path: Path
) -> None:
    """From afar, the last level's file; between two levels, more than one of them."""
    scene, f12 = shot
    only(scene, "Background")
    whole = f12()
    make_levels(run[1], rate=FAR)
    coarse = f12("coarse")
    file = run[1] / "levels" / "2" / "background.ply"
    own = engines(engine, scene, file, tmp_path / "own")
    assert psnr(coarse, whole) < 40
    assert psnr(coarse[..., :3] * coarse[..., 3:], own) > 40
    scene.roigs.use_levels = False
    assert (f12("off") == whole).all()


def test_the_look_is_rendered(blender: ModuleType, run, shot, engine, tmp_path: Path) -> None:
    """It is that of a file with such colours, as in the viewport (viewport_checks.py)."""
    scene, f12 = shot
    only(scene, "Background")
    item, plain = scene.objects["Background"], f12()
    arrays = read_ply(run[1] / "background.ply")
    arrays["sh"] = recoloured(arrays["sh"], 2**-0.5 * np.array([1.0, 0.5, 0.25]))
    write_ply(tmp_path / "tinted.ply", arrays)
    own = engines(engine, scene, tmp_path / "tinted.ply", tmp_path / "own")
    item.roigs.exposure, item.roigs.tint = -0.5, (1.0, 0.5, 0.25)
    mine = f12("tinted")
    assert psnr(mine, plain) < 40
    assert psnr(mine[..., :3] * mine[..., 3:], own) > 40


def test_an_animated_look(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    only(scene, "Background")
    item, plain = scene.objects["Background"], f12()
    for frame, exposure in ((1, 0.0), (3, -2.0)):
        item.roigs.exposure = exposure
        item.keyframe_insert("roigs.exposure", frame=frame)
    scene.frame_set(3)
    dark = f12("dark")
    assert dark[..., :3].max() < 0.5 * plain[..., :3].max()
    scene.frame_set(1)
    assert psnr(f12("again"), plain) > 50


def test_applied_transformations_change_no_picture(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    item = scene.objects["Background"]
    item.rotation_euler, item.scale = (0.4, 0.2, 1.1), (-0.8, 0.5, 1.3)
    before = f12("before")
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.object.transform_apply(location=True, rotation=True, scale=True)
    assert psnr(f12("applied"), before) > 40


def bmesh_of(item):
    import bmesh

    edit = bmesh.new()
    edit.from_mesh(item.data)
    return edit


def bmesh_delete(edit, chosen: np.ndarray) -> None:
    import bmesh

    gone = [vertex for vertex, there in zip(edit.verts, chosen, strict=True) if there]
    bmesh.ops.delete(edit, geom=gone, context="VERTS")


def black_plane(bpy: ModuleType, camera):
    """A plane that faces the camera."""
    return emitting_plane(bpy, camera, 1000, (0, 0, 0))


def test_meshes_cover_by_depth(blender: ModuleType, shot) -> None:
    bpy, (scene, f12) = blender, shot
    whole = f12()
    camera = scene.camera.matrix_world
    plane = black_plane(bpy, camera)
    plane.location = camera @ bpy_vector(0, 0, -0.01 - scene.camera.data.clip_start)
    assert f12("in front")[..., :3].max() == 0
    plane.location = camera @ bpy_vector(0, 0, -90)
    behind = f12("behind")
    assert behind[..., 3].min() == 1
    straight, alpha = whole[..., :3], whole[..., 3:]
    assert psnr(behind[..., :3], srgb(linear(straight) * alpha)) > 40


def test_a_mesh_behind_an_object_stays_behind_it(blender: ModuleType, run, shot) -> None:
    """Also where the object lets a little of a far wall through."""
    bpy, (scene, f12) = blender, shot
    camera = scene.camera.matrix_world
    to_model = scene.objects["Background"].matrix_world.inverted() @ camera
    distances = np.array([2.0, 90.0])
    discs = {  # upright before the camera: a ball as large would reach behind it
        "means": np.array([to_model @ bpy_vector(0, 0, -d) for d in distances]),
        "quats": np.array([to_model.to_quaternion()] * 2),
        "log_scales": np.log(distances[:, None] * [2.0, 2.0, 0.1]),
        "logit_opacities": np.log([9.0, 999.0]),
        "sh": np.array([[[1.0, 0, 0]], [[0, 0, 1.0]]]),
    }
    write_ply(run[1] / "background.ply", {name: a.astype(np.float32) for name, a in discs.items()})
    bpy.ops.roigs.load_results()
    only(scene, "Background")
    alone = f12("alone")
    assert alone[..., 3].min() > 0.98 and alone[..., 0].min() > 0.5
    black_plane(bpy, camera).location = camera @ bpy_vector(0, 0, -5)
    assert psnr(f12("behind")[..., :3], alone[..., :3]) > 35


def bpy_vector(*values: float):
    from mathutils import Vector

    return Vector(values)


def test_an_animation_moves(blender: ModuleType, shot, tmp_path: Path) -> None:
    bpy, (scene, f12) = blender, shot
    item = scene.objects["Background"]
    for frame, x in ((1, 0.0), (3, 1.0)):
        item.location.x = x
        item.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 3, 2
    scene.render.filepath = str(tmp_path / "frames" / "a_")
    bpy.ops.render.render(animation=True)
    first, last = (load_rgba(tmp_path / "frames" / f"a_000{n}.png") for n in (1, 3))
    for frame, picture in ((1, first), (3, last)):
        scene.frame_set(frame)
        assert psnr(f12(f"still{frame}"), picture) > 50
    assert psnr(first, last) < 40


def test_an_animation_shows_poses_without_keyframes(
    blender: ModuleType, shot, tmp_path: Path
) -> None:
    """In every frame, the first one too; the camera is keyed, what was moved is not."""
    bpy, (scene, f12) = blender, shot
    item, before = scene.objects["thing Gaussians"], f12("before")
    scene.camera.keyframe_insert("location", frame=1)
    scene.frame_set(2)
    item.location.x, item.rotation_euler.z = 0.4, 1.0
    moved = f12("moved")
    assert psnr(moved, before) < 40
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(tmp_path / "frames" / "a_")
    bpy.ops.render.render(animation=True)
    for number in (1, 2):
        assert psnr(load_rgba(tmp_path / "frames" / f"a_000{number}.png"), moved) > 50
    assert item.location.x == pytest.approx(0.4)


def test_it_survives_saving(blender: ModuleType, shot, tmp_path: Path) -> None:
    bpy, (scene, f12) = blender, shot
    before = f12()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    scene = bpy.context.scene
    scene.render.filepath = str(tmp_path / "again.png")
    bpy.ops.render.render(write_still=True)
    assert psnr(load_rgba(tmp_path / "again.png"), before) > 50


def test_the_compositor_of_the_user_stays(blender: ModuleType, run, addon) -> None:
    bpy, (scene, _) = blender, run
    from roigs_addon.scene import compositor

    if not hasattr(bpy.types, "CompositorNodeComposite"):
        pytest.skip("written for Blender 4")
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    layers, blur, end = (
        tree.nodes.new(f"CompositorNode{kind}") for kind in ("RLayers", "Blur", "Composite")
    )
    tree.links.new(layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs["Image"], end.inputs["Image"])
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.load_results()  # does nothing twice
    groups = [node for node in tree.nodes if node.type == "GROUP"]
    assert len(groups) == 1 and groups[0].node_tree == compositor.find(scene)
    assert blur.inputs["Image"].links[0].from_node == groups[0]
    assert groups[0].inputs[0].links[0].from_node == layers
    assert end.inputs["Image"].links[0].from_node == blur


def plain(blender: ModuleType, scene, f12) -> np.ndarray:
    """A mesh is added to the scene; the render of it without the compositor."""
    blender.ops.mesh.primitive_monkey_add(size=1)
    scene.render.use_compositing = False
    picture = f12("plain")
    scene.render.use_compositing = True
    assert 0.01 < picture[..., 3].mean() < 0.99
    return picture


def test_without_an_engine_the_render_is_blenders(
    blender: ModuleType, shot, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    from roigs_addon import rendering, settings
    from roigs_addon.errors import AddonError

    def none(packages: object) -> None:
        raise AddonError("There is no engine.")

    scene, f12 = shot
    own = plain(blender, scene, f12)
    monkeypatch.setattr(settings, "engine", none)
    np.testing.assert_array_equal(f12(), own)
    assert rendering.problem == "There is no engine." in capsys.readouterr().out


def test_another_kind_of_camera_is_said(blender: ModuleType, shot) -> None:
    from roigs_addon import rendering

    scene, f12 = shot
    scene.camera.data.type = "PANO"
    scene.camera.data.panorama_type = "MIRRORBALL"
    own = plain(blender, scene, f12)
    np.testing.assert_array_equal(f12(), own)
    assert "neither perspective nor orthographic" in rendering.problem


def test_what_is_scaled_to_nothing_is_not_there(blender: ModuleType, shot) -> None:
    from roigs_addon import rendering

    scene, f12 = shot
    only(scene, "Background")
    alone = f12("alone")
    scene.objects["thing Gaussians"].hide_render = False
    scene.objects["thing Gaussians"].scale = 1, 0, 1
    assert psnr(f12("flat"), alone) > 50 and not rendering.problem


def test_a_cropped_region_is_that_part_of_the_picture(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    whole, render = f12(), scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = 0.25, 0.75
    render.border_min_y, render.border_max_y = 0.5, 1.0
    part = f12("part")
    height, width = whole.shape[:2]
    assert part.shape == (height // 2, width // 2, 4)
    assert psnr(part, whole[: height // 2, width // 4 : width // 4 + width // 2]) > 40


def test_a_frame_before_the_first(blender: ModuleType, shot) -> None:
    scene, f12 = shot
    usual = f12()
    scene.frame_set(-3)
    assert psnr(f12("before"), usual) > 50


def test_depth_and_alpha_can_be_used_in_the_compositor(blender: ModuleType, shot) -> None:
    """For mist and masks: the depth is that of what is seen, Gaussians or meshes."""
    bpy, (scene, f12) = blender, shot
    from roigs_addon.scene import compositor, layer_group

    camera = scene.camera.matrix_world
    plane = black_plane(bpy, camera)
    plane.location = camera @ bpy_vector(0, 0, -90)
    whole, tree = f12(), compositor.trees(scene)[0]
    node = next(n for n in tree.nodes if n.type == "GROUP")
    end = next(n for n in tree.nodes if n.type in compositor.ENDS)
    tree.links.new(node.outputs["Gaussians"], end.inputs[0])
    alpha = linear(f12("alpha")[..., 0])
    assert 0 < alpha.mean() < 1 and alpha[whole[..., :3].sum(axis=-1) > 0.3].min() > 0.01
    scale = layer_group.either(tree, "ShaderNodeMath", "CompositorNodeMath")
    scale.operation = "MULTIPLY"
    scale.inputs[1].default_value = 0.01
    tree.links.new(node.outputs["Depth"], scale.inputs[0])
    tree.links.new(scale.outputs[0], end.inputs[0])
    depth = linear(f12("depth")[..., 0]) * 100
    assert depth[alpha == 0] == pytest.approx(90, rel=0.02)
    assert depth[alpha > 0.9].max() < 60
