"""Outputs of the compositor's node: indices, mattes and depth, beside meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import write_ply
from tests.addon.scenes import emitting_plane, through_a_photo

pytestmark = pytest.mark.exact_look

NEAR, FAR = 7, 3
"""Indices of the two discs."""
MESH = 5

Values = np.ndarray[Any, Any]


def disc(to_model: Any, depth: float, x: float, opacity: float) -> dict[str, Values]:
    """A soft disc before the camera, `x` of its depth to the right."""
    return {
        "means": np.array([to_model @ vector(x * depth, 0, -depth)], np.float32),
        "quats": np.array([to_model.to_quaternion()], np.float32),
        "log_scales": np.log(np.array([[0.1, 0.1, 0.001]], np.float32) * depth),
        "logit_opacities": np.log([opacity / (1 - opacity)]).astype(np.float32),
        "sh": np.ones((1, 1, 3), np.float32),
    }


def vector(*values: float) -> Any:
    from mathutils import Vector

    return Vector(values)


@pytest.fixture
def shot(blender: ModuleType, run, engine, tmp_path: Path):
    """Two soft discs, the nearer one before the right side of the other, and a function.

    It renders the scene, and returns the values (H, W) of an output of the compositor's node.
    """
    bpy, (scene, folder) = blender, run
    render = through_a_photo(bpy, scene)
    from roigs_addon.scene import compositor

    to_model = scene.objects["Background"].matrix_world.inverted() @ scene.camera.matrix_world
    write_ply(folder / "background.ply", disc(to_model, 6.0, -0.12, 0.999))
    write_ply(folder / "rois" / "thing.ply", disc(to_model, 4.0, 0.12, 0.8))
    bpy.ops.roigs.load_results()
    scene.objects["Background"].pass_index = FAR
    scene.objects["thing Gaussians"].pass_index = NEAR
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.view_layers[0].use_pass_object_index = True
    tree = compositor.trees(scene)[0]
    node = next(n for n in tree.nodes if n.type == "GROUP")
    end = next(n for n in tree.nodes if n.type in compositor.ENDS)

    def values(output: str, through: Any = None) -> Values:
        source = node.outputs[output]
        if through is not None:
            tree.links.new(source, through.inputs[0])
            source = through.outputs[0]
        tree.links.new(source, end.inputs[0])
        render.filepath = str(tmp_path / "values.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(render.filepath)
        width, height = image.size
        pixels = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[::-1]
        bpy.data.images.remove(image)
        return pixels[..., 0]

    return scene, node, values


def wall(bpy: ModuleType, scene: Any, depth: float) -> Any:
    """A large square that fills the picture, at a depth."""
    camera = scene.camera.matrix_world
    plane = emitting_plane(bpy, camera, 4 * depth, (0.2, 0.2, 0.2))
    plane.location = camera @ vector(0, 0, -depth)
    plane.pass_index = MESH
    return plane


def covered(scene: Any, values: Callable[..., Values]) -> tuple[Values, Values]:
    """(H, W) pixels that a mesh fills, and those that it does not touch."""
    items = [scene.objects[name] for name in ("Background", "thing Gaussians")]
    for item in items:
        item.hide_render = True
    seen = values("Object Index") == MESH
    for item in items:
        item.hide_render = False
    left, right = (np.roll(seen, by, axis=1) for by in (2, -2))
    return seen & left & right, ~(seen | left | right)


def matte(node: Any, values: Callable[..., Values], index: int) -> Values:
    node.inputs["Matte Index"].default_value = index
    return values("Matte")


def test_mattes_are_the_shares_of_objects(blender: ModuleType, shot) -> None:
    """Smooth ones: what is in front takes its part, and both add up to all Gaussians."""
    scene, node, values = shot
    near, far, all_ = matte(node, values, NEAR), matte(node, values, FAR), values("Gaussians")
    assert near.max() == pytest.approx(0.8, abs=0.02) and far.max() > 0.85
    assert ((near > 0.1) & (near < 0.7)).mean() > 0.01, "its edge is smooth"
    np.testing.assert_allclose(near + far, all_, atol=0.01)
    scene.objects["thing Gaussians"].hide_render = True
    alone = matte(node, values, FAR)
    np.testing.assert_allclose(far, alone * (1 - near), atol=0.01)
    assert matte(node, values, NEAR).max() == 0 == matte(node, values, MESH).max()


def test_meshes_in_front_cut_mattes_and_those_behind_do_not(blender: ModuleType, shot) -> None:
    scene, node, values = shot
    whole = {index: matte(node, values, index) for index in (NEAR, FAR)}
    plane = wall(blender, scene, 90.0)
    for index, before in whole.items():
        np.testing.assert_allclose(matte(node, values, index), before, atol=0.01)
    camera = scene.camera.matrix_world
    plane.location = camera @ vector(0, 0, -5)
    near, far = (matte(node, values, index) for index in (NEAR, FAR))
    front = whole[NEAR] > 1.1 * whole[FAR]
    np.testing.assert_allclose(near[front], whole[NEAR][front], atol=0.01)
    assert far[whole[FAR] > 1.1 * whole[NEAR]].max() == 0, "the mesh is between the two"
    plane.location = camera @ vector(180, 0, -1)
    filled, free = covered(scene, values)
    assert whole[NEAR][filled].max() > 0.5 < whole[FAR][free].max()
    for index, before in whole.items():
        seen = matte(node, values, index)
        assert seen[filled].max() == 0
        np.testing.assert_allclose(seen[free], before[free], atol=0.01)
    assert values("Gaussians")[filled].max() == 0


def test_the_id_mask_tells_gaussians_and_meshes_apart(blender: ModuleType, shot) -> None:
    """By the object that most of a pixel shows, as Blender's own pass does."""
    scene, node, values = shot
    near, far = matte(node, values, NEAR), matte(node, values, FAR)
    plane = wall(blender, scene, 90.0)
    plane.location = scene.camera.matrix_world @ vector(180, 0, -90)
    filled, free = covered(scene, values)
    index = values("Object Index")
    whole = (near + far > 0.52) & (abs(near - far) > 0.02)
    assert (index[whole] == np.where(near > far, NEAR, FAR)[whole]).all()
    assert {NEAR, FAR} <= set(index[whole])
    faint = near + far < 0.48
    assert (index[faint & filled] == MESH).all() and not index[faint & free].any()
    mask = node.id_data.nodes.new("CompositorNodeIDMask")
    if "Index" in mask.inputs:
        mask.inputs["Index"].default_value = NEAR
    else:
        mask.index = NEAR
    np.testing.assert_array_equal(values("Object Index", mask) > 0.5, index == NEAR)


def test_depth_is_of_what_most_of_a_pixel_shows(blender: ModuleType, shot) -> None:
    """Not of a faint rim: mist would show it as a halo before a far mesh."""
    scene, _, values = shot
    wall(blender, scene, 90.0)
    all_, depth = values("Gaussians"), values("Depth")
    assert ((all_ > 0.01) & (all_ < 0.45)).any()
    np.testing.assert_allclose(depth[all_ < 0.48], 90, rtol=0.01)
    assert depth[all_ > 0.52].max() < 7


def test_mattes_blur_with_the_picture(blender: ModuleType, shot) -> None:
    scene, node, values = shot
    sharp = matte(node, values, NEAR)
    dof = scene.camera.data.dof
    dof.use_dof, dof.focus_distance = True, 20.0
    dof.aperture_fstop = scene.camera.data.lens * 1e-3 / (2 * 0.6)
    blurred = matte(node, values, NEAR)
    assert blurred.max() < 0.9 * sharp.max()
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.2)
    np.testing.assert_allclose(blurred + matte(node, values, FAR), values("Gaussians"), atol=0.01)


def test_nothing_is_drawn_for_outputs_that_nobody_uses(
    blender: ModuleType, shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.engine.frame_engine import FrameEngine

    _, _, values = shot
    asked, draw = [], FrameEngine.draw

    def spy(self: Any, request: dict[str, Any]) -> str:
        asked.append(request["mattes"])
        return draw(self, request)

    monkeypatch.setattr(FrameEngine, "draw", spy)
    for output in ("Image", "Depth", "Gaussians", "Object Index", "Matte"):
        values(output)
    assert asked == [False, False, False, True, True]


def test_a_second_node_has_a_matte_of_its_own(blender: ModuleType, shot) -> None:
    """As duplicating the node with its links makes it: both mattes are then in one render."""
    from roigs_addon.scene import layer_group

    _, node, values = shot
    tree, all_ = node.id_data, values("Gaussians")
    second = tree.nodes.new("CompositorNodeGroup")
    second.node_tree = node.node_tree
    for mine, its in zip(node.inputs, second.inputs, strict=True):
        for link in mine.links:
            tree.links.new(link.from_socket, its)
    total = layer_group.either(tree, "ShaderNodeMath", "CompositorNodeMath")
    second.inputs["Matte Index"].default_value = FAR
    tree.links.new(second.outputs["Matte"], total.inputs[1])
    node.inputs["Matte Index"].default_value = NEAR
    np.testing.assert_allclose(values("Matte", total), all_, atol=0.01)


def test_a_matte_of_no_object_is_said(blender: ModuleType, shot) -> None:
    from roigs_addon import rendering

    scene, node, values = shot
    matte(node, values, NEAR)
    assert not rendering.problem
    assert matte(node, values, 1).max() == 0 and "Pass Index 1" in rendering.problem
    values("Gaussians")
    assert not rendering.problem
    scene.objects["Background"].pass_index = 1
    assert matte(node, values, 1).max() > 0.5 and not rendering.problem


def test_first_passes_and_later_results_keep_the_index(blender: ModuleType, shot) -> None:
    scene, _, _ = shot
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    assert scene.objects["thing first pass"].pass_index == NEAR
    blender.ops.roigs.load_results()
    assert scene.objects["thing Gaussians"].pass_index == NEAR
    assert scene.objects["Background"].pass_index == FAR
