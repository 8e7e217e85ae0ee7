"""Gaussians that leave Blender: what a render shows, as one file."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, target_of
from tests.addon.pictures import load_png, load_rgba
from tests.addon.scenes import command_line, with_cycles
from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender


@pytest.fixture(autouse=True)
def own_data_folder(addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from roigs_addon import settings

    monkeypatch.setattr(settings, "data_folder", lambda: tmp_path / "user")


@pytest.fixture
def scene(blender: ModuleType, run, engine):
    """A scene with results."""
    blender.ops.roigs.load_results()
    return run[0]


def export(bpy: ModuleType, path: Path, **options: object) -> dict[str, np.ndarray]:
    assert bpy.ops.roigs.export_gaussians(filepath=str(path), **options) == {"FINISHED"}
    return read_ply(path)


def colours(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(N, 3), as sRGB values from all sides."""
    found: np.ndarray = 0.5 + 0.28209479 * arrays["sh"][:, 0]
    return found


def places(page: Path) -> dict[str, dict[str, object]]:
    """Where a web page's buttons fly to."""
    found = re.search('<script id="page"[^>]*>(.*?)</script>', page.read_text())
    assert found
    return {item["name"]: item for item in json.loads(found[1])["places"]}


def objects(scene) -> dict[str, object]:
    return {item.name: item for item in scene.objects if item.roigs.kind == "SPLATS"}


def delete_first(item, count: int) -> None:
    """Delete points of an object, as a script does."""
    import bmesh

    made = bmesh.new()
    made.from_mesh(item.data)
    made.verts.ensure_lookup_table()
    bmesh.ops.delete(made, geom=made.verts[:count], context="VERTS")
    made.to_mesh(item.data)
    made.free()


@pytest.mark.exact_look
def test_the_file_is_what_a_render_shows(
    blender: ModuleType, scene, engine, tmp_path: Path
) -> None:
    """A turned and scaled background, an object with deleted points, a moved root, one picture."""
    from roigs_addon.jobs import current
    from roigs_addon.scene.frame_request import frame_request

    blender.ops.roigs.look_through(photo="photo 3.png")
    items = objects(scene)
    items["Background"].rotation_euler = (0.5, 1.0, -0.3)
    items["Background"].scale = (0.5, 0.5, 0.5)
    delete_first(items["thing Gaussians"], 15)
    scene.roigs.root.location = (1, 2, 3)
    scene.roigs.root.rotation_quaternion = (0.5, 0.5, 0.5, 0.5)
    render = with_cycles(scene, samples=1)
    render.dither_intensity, render.filepath = 0.0, str(tmp_path / "f12.png")
    blender.ops.render.render(write_still=True)
    found = export(blender, tmp_path / "all.ply", up="Z")
    megabytes = f"{(tmp_path / 'all.ply').stat().st_size / 1e6:.1f} MB"
    assert current.state().outcome == f"Exported all.ply: 2 objects, {megabytes}"
    assert len(found["means"]) == len(items["Background"].data.vertices) + len(
        items["thing Gaussians"].data.vertices
    )
    request = frame_request(scene, blender.context.evaluated_depsgraph_get(), "")
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": [request["camera"]]}))
    out = tmp_path / "frames"
    command_line(engine, "render", tmp_path / "all.ply", "--path", path, "--out", out)
    (picture,) = out.rglob("*.png")
    f12 = load_rgba(Path(render.filepath))
    difference = f12[..., :3] * f12[..., 3:] - load_png(picture)
    assert load_png(picture).std() > 0.02
    assert -10 * np.log10(np.square(difference).mean() + 1e-12) > 40


def test_the_axis_that_points_up(blender: ModuleType, scene, tmp_path: Path) -> None:
    files = {up: export(blender, tmp_path / f"{n}.ply", up=up) for n, up in enumerate(("Z", "Y"))}
    usual = export(blender, tmp_path / "usual.ply")
    x, y, z = files["Z"]["means"].T
    np.testing.assert_allclose(files["Y"]["means"], np.column_stack((x, z, -y)), atol=1e-5)
    np.testing.assert_allclose(usual["means"], np.column_stack((x, -z, y)), atol=1e-5)


def test_only_selected_and_fewer_degrees(blender: ModuleType, scene, tmp_path: Path) -> None:
    blender.ops.roigs.select_gaussians(name="thing Gaussians")
    blender.ops.roigs.export_gaussians(
        filepath=str(tmp_path / "thing"), selected=True, view_colour="NONE", up="Z"
    )
    found = read_ply(tmp_path / "thing.ply")  # the ending is added
    item = objects(scene)["thing Gaussians"]
    assert found["sh"].shape == (len(item.data.vertices), 1, 3)
    place = np.array(item.matrix_world)
    points = np.array([vertex.co for vertex in item.data.vertices])
    np.testing.assert_allclose(found["means"], points @ place[:3, :3].T + place[:3, 3], atol=1e-5)


def test_other_formats_by_their_names(blender: ModuleType, scene, tmp_path: Path) -> None:
    count = len(export(blender, tmp_path / "all.ply")["means"])
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "all"), file_format=".splat")
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "b.splat"), file_format=".ply")
    for name in ("all", "b"):
        assert (tmp_path / f"{name}.splat").stat().st_size == 32 * count


def test_copies_are_exported_where_they_stand(blender: ModuleType, scene, tmp_path: Path) -> None:
    item = objects(scene)["thing Gaussians"]
    copy = item.copy()
    item.users_collection[0].objects.link(copy)
    copy.location.x += 5
    blender.context.view_layer.update()
    before = len(export(blender, tmp_path / "two.ply")["means"])
    copy.hide_render = True
    assert before - len(export(blender, tmp_path / "one.ply")["means"]) == len(item.data.vertices)


def test_one_file_does_not_hold_both_kinds(blender: ModuleType, scene, tmp_path: Path) -> None:
    """With anti-aliasing and without; what is hidden does not count."""
    from roigs_addon.scene import splats

    path = random_ply(tmp_path / "smooth.ply", 5, antialiased=True)
    item = splats.show_imported(scene, path, "Smooth", in_model=True)
    with pytest.raises(RuntimeError, match=r"'Smooth' .*for Splat Viewers.* one file"):
        export(blender, tmp_path / "a.ply")
    item.select_set(True)
    assert len(export(blender, tmp_path / "a.ply", selected=True)["means"]) == 5
    assert target_of(tmp_path / "a.ply").antialiased
    item.hide_render = True
    export(blender, tmp_path / "b.ply")
    assert not target_of(tmp_path / "b.ply").antialiased


def test_a_look_that_a_script_has_just_set(blender: ModuleType, scene, tmp_path: Path) -> None:
    item = objects(scene)["thing Gaussians"]
    blender.ops.object.select_all(action="DESELECT")
    item.select_set(True)
    before = colours(export(blender, tmp_path / "before.ply", selected=True))
    item.roigs.exposure, item.roigs.tint = -1.0, (1.0, 0.5, 0.25)
    after = colours(export(blender, tmp_path / "after.ply", selected=True))
    np.testing.assert_allclose(after, before * [0.5, 0.25, 0.125], atol=1e-4)


def test_a_page_has_a_button_for_each_object(blender: ModuleType, scene, tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    item = objects(scene)["thing Gaussians"]
    copy = item.copy()
    scene.collection.objects.link(copy)
    copy.name, copy.location = "second", (5, 0, 0)
    path = tmp_path / "all.html"
    assert blender.ops.roigs.export_gaussians(filepath=str(path)) == {"FINISHED"}
    found = places(path)
    assert {"Whole scene", "thing", "second"} == set(found)
    middle = found["second"]["target"][0] - found["thing"]["target"][0]
    assert middle == pytest.approx(copy.location.x - item.location.x, abs=0.01)
    listed = Path(blender.app.tempdir) / "roigs-export.json"
    cameras = [o for o in scene.objects if o.roigs.kind == "CAMERA"]
    assert len(json.loads(listed.read_text())["photos"]) == len(cameras) > 0
    blender.ops.object.select_all(action="DESELECT")
    item.select_set(True)
    blender.ops.roigs.export_gaussians(filepath=str(path), selected=True)
    assert set(places(path)) == {"Whole scene"}
    assert json.loads(listed.read_text())["photos"] == []


def test_nothing_to_export_is_one_line(blender: ModuleType, scene, tmp_path: Path) -> None:
    for item in blender.context.selected_objects:
        item.select_set(False)
    with pytest.raises(RuntimeError, match="no Gaussians are selected"):
        blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"), selected=True)
    for item in objects(scene).values():
        item.hide_render = True
    with pytest.raises(RuntimeError, match="renders show no Gaussians"):
        blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"))
    for item in objects(scene).values():
        item.hide_render = False
    with pytest.raises(RuntimeError, match="is not a folder"):
        blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "gone" / "a.ply"))
    assert not list(tmp_path.rglob("a.ply"))


def test_a_results_own_file_is_not_replaced(blender: ModuleType, scene, run) -> None:
    own = run[1] / "background.ply"
    before = own.read_bytes()
    with pytest.raises(RuntimeError, match="is an input"):
        blender.ops.roigs.export_gaussians(filepath=str(own))
    assert own.read_bytes() == before


def test_the_next_file_is_offered_beside_the_last(
    blender: ModuleType, scene, tmp_path: Path
) -> None:
    from roigs_addon.operators import folders

    export(blender, tmp_path / "a.ply")
    assert Path(folders.for_export("")) == tmp_path


def test_the_first_file_is_offered_beside_the_project(
    blender: ModuleType, scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.operators import folders

    monkeypatch.setattr(folders, "_last", dict)
    assert not blender.data.filepath and folders.for_export("") == ""
    (tmp_path / "garden" / "sparse" / "0").mkdir(parents=True)
    assert Path(folders.for_export(str(tmp_path / "garden"))) == tmp_path


def test_the_offered_name(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    from roigs_addon.operators.export import ExportGaussians

    def offered() -> str:
        browser = SimpleNamespace(fileselect_add=lambda operator: None)
        context = SimpleNamespace(scene=blender.context.scene, window_manager=browser)
        asked = SimpleNamespace(filepath="", filename_ext=".spz")
        assert ExportGaussians.invoke(asked, context, None) == {"RUNNING_MODAL"}
        return Path(asked.filepath).name

    assert offered() == "Gaussians.spz"
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "My room.blend"))
    assert offered() == "My room.spz"
    blender.context.scene.roigs.colmap = str(tmp_path / "garden" / "sparse" / "0")
    assert offered() == "garden.spz"


def test_another_format_changes_the_ending_only(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.operators.export import ExportGaussians

    def check(path: str, ending: str) -> str:
        asked = SimpleNamespace(filepath=path, filename_ext=ending, file_format=ending)
        changed = ExportGaussians.check(asked, blender.context)
        assert changed == (asked.filepath != path)
        return asked.filepath

    path = "/a.b/scene.ply"
    for ending in (".compressed.ply", ".compressed.ply", ".spz", ".html", ".compressed.ply"):
        path = check(path, ending)
        assert path == f"/a.b/scene{ending}"
    assert check("/a.b/Scene v1.2.PLY", ".sog") == "/a.b/Scene v1.2.sog"
    assert check("/a.b/Scene v1.2", ".ply") == "/a.b/Scene v1.2.ply"
    assert check("/a.b/", ".ply") == "/a.b/"


def test_without_results_there_is_nothing_to_export(blender: ModuleType, addon) -> None:
    assert not blender.ops.roigs.export_gaussians.poll()


def middle(bpy: ModuleType, path: Path) -> np.ndarray:
    return export(bpy, path, up="Z", visible=False)["means"].mean(axis=0)


def test_what_the_viewport_hides_is_exported_where_renders_show_it(
    blender: ModuleType, scene, tmp_path: Path
) -> None:
    """Blender does not move hidden objects before they are shown again."""
    items = objects(scene)
    items["thing Gaussians"].hide_render = True
    item = items["Background"]
    start = middle(blender, tmp_path / "a.ply")
    collection = item.users_collection[0]
    layer = blender.context.view_layer.layer_collection.children[collection.name]
    scene.view_layers.new("other")
    switches = (
        (item, "hide_viewport"),
        (collection, "hide_viewport"),
        (layer, "hide_viewport"),
        (layer, "exclude"),
    )
    for number, (owner, switch) in enumerate(switches, start=1):
        setattr(owner, switch, True)
        item.location.x += 5
        moved = middle(blender, tmp_path / "a.ply") - start
        np.testing.assert_allclose(moved, (5 * number, 0, 0), atol=1e-4, err_msg=switch)
        setattr(owner, switch, False)
        blender.context.view_layer.update()
    item.hide_set(True)
    item.location.x -= 20
    scene.roigs.root.location.y += 2
    moved = middle(blender, tmp_path / "a.ply") - start
    np.testing.assert_allclose(moved, (0, 2, 0), atol=1e-4)


def test_what_h_hides_is_left_out(blender: ModuleType, scene, tmp_path: Path) -> None:
    items = objects(scene)
    hidden, other = items["Background"], items["thing Gaussians"]
    whole = len(export(blender, tmp_path / "a.ply")["means"])
    hidden.hide_set(True)
    assert len(export(blender, tmp_path / "a.ply")["means"]) == len(other.data.vertices)
    assert len(export(blender, tmp_path / "a.ply", visible=False)["means"]) == whole
    hidden.hide_set(False)
    hidden.hide_viewport = True
    assert len(export(blender, tmp_path / "a.ply")["means"]) == len(other.data.vertices)
    other.hide_set(True)
    with pytest.raises(RuntimeError, match=r"all are hidden. Show them \(Alt H\)"):
        export(blender, tmp_path / "b.ply")
    assert not (tmp_path / "b.ply").exists()


def test_what_was_deleted_in_edit_mode_is_not_exported(
    blender: ModuleType, scene, tmp_path: Path
) -> None:
    before = len(export(blender, tmp_path / "a.ply")["means"])
    item = objects(scene)["Background"]
    blender.context.view_layer.objects.active = item
    item.data.vertices.foreach_set("select", np.arange(len(item.data.vertices)) < 10)
    blender.ops.object.mode_set(mode="EDIT")
    blender.ops.mesh.delete(type="VERT")
    assert len(export(blender, tmp_path / "a.ply")["means"]) == before - 10
    assert blender.context.mode == "OBJECT"


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e38])
@pytest.mark.parametrize("what", ["location", "scale"])
def test_objects_that_stand_nowhere_are_named(
    blender: ModuleType, scene, tmp_path: Path, what: str, number: float
) -> None:
    item = objects(scene)["Background"]
    setattr(item, what, (number, number, number))
    with pytest.raises(RuntimeError) as caught:
        blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"))
    assert "'Background' is too far away or too large" in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_names_that_are_no_files(blender: ModuleType, scene, tmp_path: Path) -> None:
    for name in (f"{tmp_path}/", f"{tmp_path}/ "):
        with pytest.raises(RuntimeError, match="is a folder"):
            blender.ops.roigs.export_gaussians(filepath=name)
    with pytest.raises(RuntimeError, match=r"Save the \.blend first"):
        blender.ops.roigs.export_gaussians(filepath="//a.ply")
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert blender.ops.roigs.export_gaussians(filepath="//a.ply") == {"FINISHED"}
    assert (tmp_path / "a.ply").is_file()


def test_a_name_that_is_no_text(blender: ModuleType, scene, tmp_path: Path) -> None:
    path = tmp_path / "\udcff.ply"
    assert blender.ops.roigs.export_gaussians(filepath=str(path)) == {"FINISHED"}
    assert path.is_file()
