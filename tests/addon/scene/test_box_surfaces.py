"""The mesh of a box: where it stands, what is shown, how it is replaced."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.surface_cases import CENTRE, RADIUS, write_ball

pytestmark = pytest.mark.blender


@pytest.fixture
def ball(blender: ModuleType, run):
    """A scene with results, the file of a mesh, and what shows it."""
    from roigs_addon.scene import box_surfaces

    scene, folder = run
    blender.ops.roigs.load_results()
    path = folder / "rois" / "thing.glb"
    write_ball(path)
    return scene, path, lambda: box_surfaces.show(scene, "thing", path)


def in_the_world(item) -> np.ndarray:
    """(N, 3) where an object's vertices are."""
    import bpy

    bpy.context.view_layer.update()
    flat = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", flat)
    matrix = np.array(item.matrix_world)
    return flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def in_the_model(scene, item) -> np.ndarray:
    """(N, 3) the same in the frame of the COLMAP model."""
    back = np.linalg.inv(np.array(scene.roigs.root.matrix_world))
    return in_the_world(item) @ back[:3, :3].T + back[:3, 3]


@pytest.mark.parametrize("moved", [False, True])
def test_it_stands_where_the_gaussians_do(blender: ModuleType, ball, moved: bool) -> None:
    from roigs_engine.formats.splat_ply import read_ply

    scene, path, show = ball
    root, gaussians = scene.roigs.root, scene.objects["thing Gaussians"]
    root.rotation_mode = "XYZ"
    root.rotation_euler, root.scale, root.location = (0.3, 1.2, -0.4), (2.5,) * 3, (4, 5, 6)
    if moved:
        gaussians.rotation_euler.z += 0.7
        gaussians.location.x += 1.5
        gaussians.scale *= 0.5
    blender.context.view_layer.update()
    item = show()
    assert item.name == "thing Mesh" and item.parent == root
    assert item.users_collection == gaussians.users_collection
    trained = read_ply(path.with_suffix(".ply"))["means"]
    # The map that takes the trained places to where the Gaussians are takes the mesh there, too.
    there = np.c_[trained, np.ones(len(trained))]
    placed = np.linalg.lstsq(there, in_the_world(gaussians), rcond=None)[0]
    points = in_the_world(item)
    expected = np.array([*CENTRE, 1]) @ placed
    assert points.mean(axis=0) == pytest.approx(expected, abs=0.02 * RADIUS)
    scale = 2.5 * (0.5 if moved else 1)
    radii = np.linalg.norm(points - expected, axis=1)
    assert radii == pytest.approx(np.full(len(radii), RADIUS * scale), rel=1e-4)


@pytest.mark.parametrize("edited", [False, True])
def test_the_size_of_a_hidden_mesh(blender: ModuleType, ball, edited: bool) -> None:
    from roigs_addon.scene import box_surfaces, taken
    from roigs_addon.ui import surface

    scene, _, show = ball
    item, root = show(), scene.roigs.root
    if edited:
        item.data.vertices[0].co.x += 1e-4
        item.data.update()
    blender.context.view_layer.update()
    assert "40 cm × 40 cm × 40 cm" in surface.facts(scene, item)
    before = np.array(box_surfaces.foot(item))
    item.hide_viewport = True
    blender.context.view_layer.update()
    root.scale, root.location.z = (2, 2, 2), 1.0
    blender.context.view_layer.update()
    assert "80 cm × 80 cm × 80 cm" in surface.facts(scene, item)
    assert list(box_surfaces.foot(item)) == pytest.approx(2 * before + (0, 0, 1), abs=1e-3)
    asset = taken.take(scene, item)
    assert max(asset.objects["thing Mesh.001"].dimensions) == pytest.approx(4 * RADIUS, abs=1e-3)


def test_it_is_one_closed_mesh_with_the_picture(blender: ModuleType, ball) -> None:
    import bmesh

    scene, _, show = ball
    item = show()
    mesh = bmesh.new()
    mesh.from_mesh(item.data)
    assert all(edge.is_manifold for edge in mesh.edges)
    assert mesh.calc_volume(signed=True) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.1)
    mesh.free()
    assert not item.data.validate() and len(item.data.uv_layers) == 1
    (material,) = item.data.materials
    (image,) = (n.image for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    assert tuple(image.size) == (8, 8) and image.packed_file is not None
    assert image.pixels[0] == pytest.approx(200 / 255, abs=0.01)
    assert in_the_model(scene, item).mean(axis=0) == pytest.approx(CENTRE, abs=0.01)


def test_gaussians_mesh_or_both(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces

    scene, _, show = ball
    item, gaussians = show(), scene.objects["thing Gaussians"]
    background, first = scene.objects["Background"], scene.objects["thing first pass"]
    assert box_surfaces.way_of(scene, item) == "MESH"
    blender.context.view_layer.objects.active = item
    for way, seen in (("GAUSSIANS", (1, 0)), ("BOTH", (1, 1)), ("MESH", (0, 1))):
        blender.ops.roigs.show_surface(name=item.name, way=way)
        assert blender.context.view_layer.objects.active == (gaussians if way != "MESH" else item)
        assert box_surfaces.way_of(scene, item) == way
        for shown, each in zip(seen, (gaussians, item), strict=True):
            assert (not each.hide_render, not each.hide_viewport) == (shown, shown)
        assert not background.hide_render and first.hide_render
    gaussians.hide_set(True)
    blender.ops.roigs.show_surface(name=item.name, way="BOTH")
    assert gaussians.visible_get()
    blender.ops.roigs.show_surface(name=item.name, way="MESH")
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    assert first.hide_render  # the first pass is shown as the result was: not
    with pytest.raises(RuntimeError, match="no mesh"):
        blender.ops.roigs.show_surface(name="thing", way="MESH")


def test_a_copy_of_the_gaussians_stays(blender: ModuleType, ball) -> None:
    scene, _, show = ball
    copy = scene.objects["thing Gaussians"].copy()
    scene.collection.objects.link(copy)
    show()
    assert scene.objects["thing Gaussians"].hide_render and not copy.hide_render


def test_without_gaussians_it_stands_in_the_model(blender: ModuleType, ball) -> None:
    scene, _, show = ball
    for item in [o for o in scene.objects if o.roigs.kind == "SPLATS"]:
        blender.data.objects.remove(item)
    item = show()
    assert in_the_model(scene, item).mean(axis=0) == pytest.approx(CENTRE, abs=0.01)
    assert not item.hide_viewport


def test_made_again_it_replaces_the_data_alone(blender: ModuleType, ball) -> None:
    from mathutils import Matrix

    scene, path, show = ball
    item = show()
    item.location.x += 3
    item.modifiers.new("Solid", "SOLIDIFY")
    twin = item.copy()
    scene.collection.objects.link(twin)
    (material,) = item.data.materials
    material.diffuse_color = (1, 0, 0, 1)
    before, images = in_the_world(item), len(blender.data.images)
    item.data.transform(Matrix.Scale(2, 4))  # as Object > Apply does
    item.scale /= 2
    write_ball(path, radius=2 * RADIUS, colour=90)
    assert show() == item and twin.data == item.data
    assert item.modifiers[0].name == "Solid" and list(item.data.materials) == [material]
    assert len(blender.data.images) == images and len(blender.data.meshes) > 0
    (image,) = (n.image for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    assert image.pixels[0] == pytest.approx(90 / 255, abs=0.01)
    middle = before.mean(axis=0)
    after = in_the_world(item)
    assert after.mean(axis=0) == pytest.approx(middle, abs=1e-4)
    ratio = np.linalg.norm(after - middle, axis=1) / np.linalg.norm(before - middle, axis=1)
    assert ratio == pytest.approx(np.full(len(ratio), 2.0), rel=1e-3)


def test_what_an_edit_is(blender: ModuleType, ball) -> None:
    import bmesh

    from roigs_addon.scene import box_surfaces

    scene, _, show = ball
    item = show()
    assert box_surfaces.edited(scene) == []
    item.location.x += 1
    item.data.materials[0].diffuse_color = (0, 1, 0, 1)
    blender.context.view_layer.update()
    assert box_surfaces.edited(scene) == []  # a new mesh keeps these
    blender.context.view_layer.objects.active = item
    blender.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(item.data)
    mesh.faces.ensure_lookup_table()
    bmesh.ops.delete(mesh, geom=[mesh.faces[0]], context="FACES_ONLY")
    blender.ops.object.mode_set(mode="OBJECT")
    blender.context.view_layer.update()
    assert box_surfaces.edited(scene) == ["thing Mesh"]
    show()
    assert box_surfaces.edited(scene) == []
    (image,) = box_surfaces._images(item.data)
    image.pixels[0] = 0.5
    assert box_surfaces.edited(scene, ["thing"]) == ["thing Mesh"]
    assert box_surfaces.edited(scene, ["other"]) == []


def test_another_result_is_named(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces
    from tests.addon.splat_cases import random_ply

    scene, path, show = ball
    item = show()
    assert not box_surfaces.is_of_other_result(scene, item)
    random_ply(path.with_suffix(".ply"), 51, seed=9)
    blender.ops.roigs.load_results()
    assert box_surfaces.is_of_other_result(scene, item)
    assert scene.objects["thing Gaussians"].hide_viewport  # as it was shown
    show()
    assert not box_surfaces.is_of_other_result(scene, item)


def test_results_bring_their_meshes(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces
    from roigs_engine.formats.files import sha256
    from tests.addon.splat_cases import random_ply

    scene, path, _ = ball
    write_ball(path, result=sha256(path.with_suffix(".ply")))
    blender.ops.roigs.load_results()
    item, gaussians = scene.objects["thing Mesh"], scene.objects["thing Gaussians"]
    assert item.hide_viewport and item.hide_render and not gaussians.hide_viewport
    blender.ops.roigs.show_surface(name=item.name, way="BOTH")
    write_ball(path, radius=2 * RADIUS, result=sha256(path.with_suffix(".ply")))
    blender.ops.roigs.load_results()  # it was made again in a terminal
    assert item.dimensions.x == pytest.approx(4 * RADIUS, rel=0.02)
    assert box_surfaces.way_of(scene, item) == "BOTH"
    item.data.vertices[0].co.x += 1
    item.data.update()
    blender.context.view_layer.update()
    mesh = item.data
    write_ball(path, result=sha256(path.with_suffix(".ply")))
    assert "edited, and is kept" in box_surfaces.load(scene, path.parent.parent)[0]
    assert item.data == mesh
    random_ply(path.with_suffix(".ply"), 51, seed=9)
    assert "earlier training" in box_surfaces.load(scene, path.parent.parent)[0]
    blender.data.objects.remove(item)
    blender.ops.roigs.load_results()
    assert "thing Mesh" not in scene.objects
    path.write_bytes(b"no mesh")
    path.with_suffix(".surface.json").write_text("{}")
    assert blender.ops.roigs.load_results() == {"FINISHED"}


def test_a_mesh_alone(blender: ModuleType, ball) -> None:
    scene, _, show = ball
    item, gaussians = show(), scene.objects["thing Gaussians"]
    background, first = scene.objects["Background"], scene.objects["thing first pass"]
    background.hide_viewport = True  # and rendered
    copy = gaussians.copy()
    scene.collection.objects.link(copy)
    copy.hide_viewport = copy.hide_render = False
    blender.ops.roigs.show_alone(name=item.name)
    others = (background, first, gaussians, copy)
    assert all(each.hide_viewport and each.hide_render for each in others)
    assert not item.hide_render and blender.context.view_layer.objects.active == item
    low = in_the_world(item).min(axis=0)
    assert scene.cursor.location.z == pytest.approx(low[2], abs=1e-3)
    blender.ops.roigs.show_alone(name=item.name)
    assert background.hide_viewport and not background.hide_render
    assert first.hide_render and gaussians.hide_render and not copy.hide_render
    blender.ops.roigs.show_alone(name=item.name)
    blender.ops.roigs.show_surface(name=item.name, way="BOTH")
    assert not background.hide_render and not gaussians.hide_viewport
    with pytest.raises(RuntimeError, match="no mesh"):
        blender.ops.roigs.show_alone(name="thing")


def test_it_is_exported_for_print(blender: ModuleType, ball, tmp_path: Path) -> None:
    scene, _, show = ball
    item, file = show(), tmp_path / "thing.stl"
    scene.unit_settings.scale_length = 0.01
    blender.ops.mesh.primitive_plane_add()
    blender.ops.roigs.export_surface(name=item.name, filepath=str(file))
    data = file.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    facets = np.frombuffer(data, np.dtype([("f", "<f4", (4, 3)), ("n", "<u2")]), count, 84)
    corners = facets["f"][:, 1:].reshape(-1, 3)
    assert count == len(item.data.polygons)
    assert np.ptp(corners, axis=0) == pytest.approx([20 * RADIUS] * 3, rel=0.02)  # millimetres
    blender.ops.roigs.show_surface(name=item.name, way="GAUSSIANS")
    with pytest.raises(RuntimeError, match="'thing Mesh' is hidden"):
        blender.ops.roigs.export_surface(name=item.name, filepath=str(file))


def test_a_copy_keeps_its_texture(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces

    scene, path, show = ball
    item = show()
    copy = item.copy()
    copy.data = item.data.copy()  # as Shift-D does: with the same material
    scene.collection.objects.link(copy)
    write_ball(path, radius=2 * RADIUS, colour=90)
    assert show() == item
    for each, colour in ((item, 90), (copy, 200)):
        (image,) = box_surfaces._images(each.data)
        assert image.pixels[0] == pytest.approx(colour / 255, abs=0.01)


@pytest.mark.parametrize("damage", ["short", "text", "index", "none", "record"])
def test_a_damaged_file_is_one_line(blender: ModuleType, ball, damage: str) -> None:
    from roigs_addon.errors import AddonError

    scene, path, show = ball
    data = path.read_bytes()
    if damage == "record":
        path.with_suffix(".surface.json").write_text("{")
    elif damage == "none":
        path.unlink()
    else:
        at = data.find(b'"POSITION": 0')
        path.write_bytes(
            {
                "short": data[:5000],
                "text": b"no mesh",
                "index": data[:at] + b'"POSITION": 9' + data[at + 13 :],
            }[damage]
        )
    before = len(scene.objects)
    with pytest.raises(AddonError, match=r"Make the surface again\.$") as caught:
        show()
    assert "\n" not in str(caught.value) and len(scene.objects) == before


def test_undo_brings_back_the_mesh_and_its_picture(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces

    _, path, show = ball
    item = show()
    item.data.vertices[0].co.x += 0.5
    edited = item.dimensions.x
    blender.ops.ed.undo_push(message="edited")
    write_ball(path, radius=2 * RADIUS, colour=90)
    show()
    blender.ops.ed.undo_push(message="made again")
    blender.ops.roigs.show_surface(name="thing Mesh", way="BOTH")
    blender.ops.ed.undo_push(message="both")
    blender.ops.ed.undo()
    (item,) = box_surfaces.surfaces(blender.context.scene)
    assert box_surfaces.way_of(blender.context.scene, item) == "MESH"
    blender.ops.ed.undo()
    (item,) = box_surfaces.surfaces(blender.context.scene)
    blender.context.view_layer.update()
    assert box_surfaces.is_edited(item) and item.dimensions.x == pytest.approx(edited, abs=0.2)
    (image,) = box_surfaces._images(item.data)
    assert image.pixels[0] == pytest.approx(200 / 255, abs=0.01)


def test_the_file_of_a_mesh_is_no_box(blender: ModuleType, ball) -> None:
    scene, path, _ = ball
    path.with_name("thing.surface.ply").write_bytes(b"ply")
    assert blender.ops.roigs.load_results() == {"FINISHED"}
    assert not any("surface" in item.name for item in scene.objects)


def test_a_file_keeps_it(blender: ModuleType, ball, tmp_path: Path) -> None:
    from roigs_addon.scene import box_surfaces

    scene, _, show = ball
    show()
    blend = tmp_path / "kept.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(blend))
    blender.ops.wm.open_mainfile(filepath=str(blend))
    scene = blender.context.scene
    (item,) = box_surfaces.surfaces(scene)
    assert not box_surfaces.is_edited(item) and box_surfaces.record(item)["filled"] == 0.03
    assert box_surfaces.way_of(scene, item) == "MESH"


def test_another_file_takes_it(blender: ModuleType, ball, tmp_path: Path) -> None:
    from roigs_addon.scene import box_surfaces
    from roigs_addon.ui import surface
    from tests.addon.panels import said

    scene, path, show = ball
    scene.roigs.root.scale = (3, 3, 3)
    item = show()
    places, blend = in_the_world(item), tmp_path / "kept.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(blend))
    shutil.rmtree(path.parent.parent)  # as on another computer
    blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender.ops.wm.append(directory=f"{blend}/Object/", filename="thing Mesh")
    scene = blender.context.scene
    (item,) = box_surfaces.surfaces(scene)
    assert in_the_world(item) == pytest.approx(places, abs=1e-5)
    (image,) = box_surfaces._images(item.data)
    assert image.packed_file is not None and image.pixels[0] == pytest.approx(200 / 255, abs=0.01)
    assert not box_surfaces.is_edited(item) and not box_surfaces.is_of_other_result(scene, item)
    labels = " ".join(said(blender, surface.SurfacePanel))
    assert "528 faces, 1.2 m" in labels and "another result" not in labels
    blender.ops.roigs.show_alone(name=item.name)
    blender.ops.roigs.show_surface(name=item.name, way="GAUSSIANS")
    assert item.hide_render  # there are none: nothing is shown
    blender.ops.roigs.show_surface(name=item.name, way="MESH")
    assert not item.hide_render


def test_renamed_and_deleted(blender: ModuleType, ball) -> None:
    scene, path, show = ball
    item = show()
    item.name = "my pot"
    write_ball(path, radius=2 * RADIUS)
    assert show() == item and item.name == "my pot"
    blender.data.objects.remove(item)
    item = show()
    assert item.name == "thing Mesh" and scene.objects["thing Gaussians"].hide_render


@pytest.mark.parametrize("mode", ["SCULPT", "VERTEX_PAINT", "TEXTURE_PAINT", "WEIGHT_PAINT"])
def test_made_again_while_it_is_painted(blender: ModuleType, ball, mode: str) -> None:
    from roigs_addon.scene import box_surfaces

    scene, path, show = ball
    item = show()
    blender.context.view_layer.update()
    blender.context.view_layer.objects.active = item
    item.select_set(True)
    blender.ops.object.mode_set(mode=mode)
    write_ball(path, radius=2 * RADIUS)
    assert show() == item and item.mode == "OBJECT"
    blender.context.view_layer.update()
    assert item.dimensions.x == pytest.approx(4 * RADIUS, rel=0.02)
    assert not box_surfaces.edited(scene)


def test_modifiers_that_are_applied_are_edits(blender: ModuleType, ball) -> None:
    from roigs_addon.scene import box_surfaces

    scene, _, show = ball
    item = show()
    modifier = item.modifiers.new("Fewer", "DECIMATE")
    modifier.ratio = 0.5
    blender.context.view_layer.update()
    assert not box_surfaces.edited(scene)  # a new mesh keeps it
    blender.context.view_layer.objects.active = item
    blender.ops.object.modifier_apply(modifier="Fewer")
    blender.context.view_layer.update()
    assert box_surfaces.edited(scene) == ["thing Mesh"]
