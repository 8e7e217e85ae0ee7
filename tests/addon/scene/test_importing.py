"""Import Cameras, and what a user does with the cameras."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.colmap_project import PARAMS, POINTS, ring, write_large_model, write_project
from tests.addon.scenes import add_box, drawn_points, imported, record

pytestmark = pytest.mark.blender


def test_what_is_imported(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    from roigs_addon.scene import cameras, clouds, lookup

    scene = imported(blender, project)
    root, found = scene.roigs.root, lookup.cameras(scene)
    assert root.roigs.kind == "ROOT" and scene.roigs.colmap == str(project)
    assert sorted(found) == [f"photo {index}.png" for index in range(8)]
    for index, pose in enumerate(ring(8)):
        item = found[f"photo {index}.png"]
        photo = cameras.photo_of(item, root)
        assert item.parent == root and Path(photo.path).is_file()
        np.testing.assert_allclose(photo.pose, pose, atol=1e-12)
        k = photo.intrinsics
        assert (k.fx, k.fy, k.cx, k.cy) == PARAMS
    cloud = lookup.points(scene)
    assert cloud.parent == root
    assert len(clouds.positions(cloud)) == POINTS
    assert not blender.data.images  # photos are loaded when they are looked at
    assert scene.roigs.skipped == ""


def test_points_are_where_and_what_colmap_says(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.scene import clouds, lookup

    scene = imported(blender, project)
    lines = (project / "sparse" / "0" / "points3D.txt").read_text().splitlines()
    rows = np.array([[float(v) for v in line.split()[1:7]] for line in lines])
    cloud = lookup.points(scene)
    order = np.lexsort(rows[:, :3].T)
    mine = clouds.positions(cloud)
    mine_order = np.lexsort(mine.T.astype(float))
    np.testing.assert_allclose(mine[mine_order], rows[order, :3], atol=1e-6)
    colours = np.empty(4 * len(rows), np.float32)
    cloud.data.attributes["Color"].data.foreach_get("color", colours)
    srgb = rows[order, 3:] / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(colours.reshape(-1, 4)[mine_order, :3], linear, atol=1e-5)


def test_the_points_are_drawn_as_points(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.scene import lookup

    scene = imported(blender, project)
    cloud = lookup.points(scene)
    assert not cloud.modifiers["Points"].show_in_editmode  # there, the selection is to be seen
    drawn = drawn_points(blender)[cloud.name]
    assert drawn["points"] == POINTS and drawn["radius"] > 0 and "Color" in drawn["attributes"]


def test_the_scene_stands_upright(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    from roigs_addon.scene import lookup

    scene = imported(blender, project)  # the model's y points down
    ups = [camera.matrix_world.col[1].z for camera in lookup.cameras(scene).values()]
    assert min(ups) > 0.9


def test_looking_through_a_photo(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    bpy, scene = blender, imported(blender, project)
    bpy.ops.roigs.look_through(photo="photo 3.png")
    render = scene.render
    assert (render.resolution_x, render.resolution_y) == (64, 48)
    assert render.pixel_aspect_y / render.pixel_aspect_x == pytest.approx(60 / 54)
    (background,) = scene.camera.data.background_images
    assert Path(bpy.path.abspath(background.image.filepath)).name == "photo 3.png"
    assert len(bpy.data.images) == 1
    assert scene.camera.data.show_background_images
    for step, name in ((1, "photo 4.png"), (-1, "photo 3.png"), (-4, "photo 7.png")):
        bpy.ops.roigs.look_through(step=step)
        assert json.loads(scene.camera.roigs.photo)["name"] == name
    bpy.ops.roigs.look_through(photo="photo 3.png")
    assert len(scene.camera.data.background_images) == 1
    with pytest.raises(RuntimeError, match="no such photo"):
        bpy.ops.roigs.look_through(photo="photo 9.png")


def test_only_the_photo_that_is_looked_through_is_in_memory(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    bpy, scene = blender, imported(blender, project)

    def image(photo: str):
        bpy.ops.roigs.look_through(photo=photo)
        (background,) = scene.camera.data.background_images
        assert len(background.image.pixels) and background.image.has_data
        return background.image

    first = image("photo 3.png")
    second = image("photo 4.png")
    assert second.has_data and not first.has_data
    assert image("photo 3.png") == first and not second.has_data
    first.pixels[0] = 0.5  # painted on
    image("photo 4.png")
    assert first.is_dirty and first.has_data


def test_the_photo_at_hand(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    """The button between the arrows looks through the photo that it names."""
    from roigs_addon.scene import lookup
    from roigs_addon.ui.scene import photo_at_hand

    bpy = blender
    with pytest.raises(RuntimeError, match="import cameras first"):
        bpy.ops.roigs.look_through()
    scene = imported(bpy, project)
    assert photo_at_hand(bpy.context) == "Look Through"
    bpy.ops.roigs.look_through()  # nothing is chosen yet: the first one
    assert scene.camera == lookup.cameras(scene)["photo 0.png"]
    bpy.ops.roigs.look_through(photo="photo 3.png")
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    found = lookup.cameras(scene)
    for active, photo in ((scene.objects["thing"], "photo 3"), (found["photo 5.png"], "photo 5")):
        bpy.context.view_layer.objects.active = active
        assert photo_at_hand(bpy.context) == photo
        bpy.ops.roigs.look_through()
        assert scene.camera == found[f"{photo}.png"]
        bpy.ops.roigs.look_through(step=1)  # the name goes with it, and so does the next step
        bpy.ops.roigs.look_through(step=-1)
        bpy.ops.roigs.look_through(step=-1)
        before = f"photo {int(photo[-1]) - 1}"
        assert photo_at_hand(bpy.context) == before
        assert scene.camera == found[f"{before}.png"]


def test_any_way_of_making_a_camera_active(
    blender: ModuleType, addon: ModuleType, project: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, imported(blender, project)
    found = lookup.cameras(scene)
    render = scene.render
    for name, width in (("photo 1.png", 64), ("photo 2.png", 64)):
        render.resolution_x = 1000
        scene.camera = found[name]
        bpy.context.view_layer.update()
        assert render.resolution_x == width
        assert len(found[name].data.background_images) == 1
    render.resolution_x = 500  # by the user, afterwards
    scene.camera.location.x += 0.1
    bpy.context.view_layer.update()
    assert render.resolution_x == 500
    scene.camera = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    bpy.context.view_layer.update()
    assert render.resolution_x == 500


def test_looking_through_a_missing_photo(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    scene = imported(blender, write_project(tmp_path / "a"))
    shutil.rmtree(tmp_path / "a" / "images")
    blender.ops.roigs.look_through(photo="photo 1.png")
    assert scene.render.resolution_x == 64 and not scene.camera.data.background_images


def test_what_is_skipped_is_counted(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    project = write_project(tmp_path / "a")
    for index in (2, 5):
        (project / "images" / f"photo {index}.png").unlink()
    scene = imported(blender, project)
    assert scene.roigs.skipped == "2 photos left out: missing on disk"


def test_a_photo_without_a_pose_is_said_in_words(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.scene.importing import skipped_in_words
    from roigs_engine.colmap.photo_loader import UNPOSED

    one, two = ({UNPOSED: {"count": count}} for count in (1, 2))
    assert skipped_in_words(one) == "1 photo left out: its camera was not found"
    assert skipped_in_words(two) == "2 photos left out: their cameras were not found"


def test_a_model_in_map_coordinates_is_warned_of(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """Blender's numbers have 32 bits; the warning is in the panel, and says what to do."""
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import IMPORTING
    from roigs_addon.ui.scene import ScenePanel
    from tests.addon.panels import said

    imported(blender, write_project(tmp_path / "near"))
    assert not current.warnings(IMPORTING)
    imported(blender, write_project(tmp_path / "far", origin=(5e5, 5e6, 100.0)))
    (warning,) = current.warnings(IMPORTING)
    assert "steps of 0.5" in warning and "move the model to the origin" in warning
    assert any("steps of 0.5" in text for text in said(blender, ScenePanel))


def test_importing_again_replaces(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, imported(blender, project)
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    root = scene.roigs.root
    root.scale = 2, 2, 2
    root.location = 1, 2, 3
    bpy.context.view_layer.update()
    matrix, before = root.matrix_world.copy(), record(lookup.rois(scene)[0], scene)
    counts = {
        name: len(getattr(bpy.data, name))
        for name in ("objects", "cameras", "meshes", "collections")
    }
    imported(bpy, project)
    assert scene.roigs.root == root and root.matrix_world == matrix
    assert record(lookup.rois(scene)[0], scene) == before
    assert counts == {name: len(getattr(bpy.data, name)) for name in counts}
    # Another model: its cameras, and its own way up.
    imported(bpy, write_project(tmp_path / "other", photos=5))
    assert len(lookup.cameras(scene)) == 5 and scene.roigs.root == root
    assert root.matrix_world != matrix
    assert len(bpy.data.cameras) == 5


def test_a_moved_project_keeps_the_roots_place(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    bpy, scene = blender, imported(blender, write_project(tmp_path / "a"))
    root = scene.roigs.root
    root.location = 1, 2, 3
    bpy.context.view_layer.update()
    matrix, cache = root.matrix_world.copy(), scene.roigs.model_cache
    (tmp_path / "a").rename(tmp_path / "b")
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    with pytest.raises(RuntimeError, match="Import it again from its new place"):
        bpy.ops.roigs.select_cameras()
    imported(bpy, tmp_path / "b")
    assert scene.roigs.model_cache != cache
    assert scene.roigs.root == root and root.matrix_world == matrix
    # Other poses in the same folder: another frame.
    shutil.rmtree(tmp_path / "b")
    imported(bpy, write_project(tmp_path / "b", photos=5))
    assert root.matrix_world != matrix
    # A root that was never placed.
    bpy.data.objects.remove(root)
    imported(bpy, tmp_path / "b")
    assert scene.roigs.root.matrix_world.to_quaternion().angle > 1


def test_importing_again_spares_the_users_cameras(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, scene = blender, imported(blender, project)
    photo = lookup.cameras(scene)["photo 3.png"]
    photo.select_set(True)
    bpy.context.view_layer.objects.active = photo
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    assert copy != photo and lookup.cameras(scene)["photo 3.png"] == photo
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    photo.users_collection[0].objects.link(own)
    bpy.ops.roigs.look_through(photo="photo 4.png")
    scene.render.resolution_x = 500
    for folder in (project, write_project(tmp_path / "other", photos=5)):
        imported(bpy, folder)
        assert {copy, own} < set(scene.objects)
        names = {item.name for item in scene.objects if item.type == "CAMERA"}
        assert names == {*lookup.cameras(scene), copy.name, "own"}
        assert scene.camera == lookup.cameras(scene)["photo 4.png"]
        assert len(scene.camera.data.background_images) == 1
        assert scene.render.resolution_x == 500
    scene.camera = copy
    imported(bpy, project)
    assert scene.camera == copy and len(bpy.data.collections) == 2


def test_errors_are_the_engines_own_words(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current

    bpy = blender
    with pytest.raises(RuntimeError, match="There is no folder") as error:
        bpy.ops.roigs.import_colmap(directory=str(tmp_path / "nowhere"))
    with pytest.raises(RuntimeError, match="COLMAP") as error:
        bpy.ops.roigs.import_colmap(directory=str(tmp_path))
    text = str(error.value).removeprefix("Error: ").strip()
    assert text and "\n" not in text and "Traceback" not in text
    assert current.state().error == text
    assert bpy.context.scene.roigs.root is None and not bpy.data.cameras


def test_the_name_of_a_project(addon: ModuleType) -> None:
    from roigs_addon.jobs.import_job import project_name

    for path in ("/a/garden", "/a/garden/sparse", "/a/garden/sparse/0", "/a/garden/sparse/refined"):
        assert project_name(Path(path)) == "garden"


@pytest.mark.slow
def test_a_thousand_cameras_and_a_million_points(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    project = write_large_model(tmp_path / "large", 1000, 1_000_000, 3000)
    start = time.process_time()
    scene = imported(blender, project)
    seconds = time.process_time() - start
    print(f"{seconds:.1f} s")
    assert len(lookup.cameras(scene)) == 1000
    assert len(lookup.points(scene).data.vertices) == 1_000_000
    assert not blender.data.images
    assert seconds < 15
