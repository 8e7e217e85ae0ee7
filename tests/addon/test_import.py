"""Gaussians that come into Blender: a file of any format as an object."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine import machine
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import turn
from roigs_engine.formats.splat_ply import read_ply, target_of, write_ply
from roigs_engine.formats.targets import TARGETS, VIEWERS, Target
from tests.addon.fake_engine import use
from tests.addon.pictures import load_png, load_rgba
from tests.addon.scenes import command_line, imported, with_cycles
from tests.addon.splat_cases import random_arrays

pytestmark = pytest.mark.blender


@pytest.fixture(autouse=True)
def own_data_folder(addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from roigs_addon import settings

    monkeypatch.setattr(settings, "data_folder", lambda: tmp_path / "user")


def bring(bpy: ModuleType, path: Path, **options: str):
    """The object of a file."""
    before = set(bpy.context.scene.objects)
    assert bpy.ops.roigs.import_gaussians(filepath=str(path), **options) == {"FINISHED"}
    (item,) = set(bpy.context.scene.objects) - before
    return item


def points(item) -> np.ndarray:
    """(N, 3) in the world."""
    place = np.array(item.matrix_world)
    return np.array([v.co for v in item.data.vertices]) @ place[:3, :3].T + place[:3, 3]


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    write_ply(tmp_path / "My vase.ply", random_arrays(50, seed=3))
    return tmp_path / "My vase.ply"


@pytest.mark.parametrize("form", formats.FORMATS, ids=lambda form: form.suffix)
def test_every_format_stands_upright(
    blender: ModuleType, engine, tmp_path: Path, form: formats.FileFormat
) -> None:
    """The file's up direction, by its convention, becomes Blender's z."""
    if not form.reads:
        pytest.skip("only written")
    random = np.random.default_rng(0)
    arrays = random_arrays(60, seed=1, coefficients=1)
    arrays["means"] = random.uniform((-1, -1, 0), (1, 1, 3), (60, 3)).astype(np.float32)
    write_ply(tmp_path / "z.ply", arrays)
    path = tmp_path / f"vase{form.suffix}"
    try:
        command_line(engine, "convert", tmp_path / "z.ply", path, "--from-up", "z")
    except subprocess.CalledProcessError as error:
        pytest.skip(error.stderr)
    item = bring(blender, path)
    assert item.name == "vase" and item.parent is None
    found = points(item)
    np.testing.assert_allclose(found.min(axis=0), arrays["means"].min(axis=0), atol=0.02)
    np.testing.assert_allclose(found.max(axis=0), arrays["means"].max(axis=0), atol=0.02)


def test_every_readable_format_can_be_chosen(addon: ModuleType) -> None:
    from roigs_addon.jobs.import_gaussians_job import ENDINGS, ONLY_IMPORTED
    from roigs_addon.operators.import_gaussians import GaussiansHandler

    assert set(ENDINGS) == {form.suffix for form in formats.FORMATS if form.reads}
    assert set(ONLY_IMPORTED) == {form.suffix for form in formats.READ_ONLY}
    dropped = {*ENDINGS, *ONLY_IMPORTED} - {".compressed.ply", "meta.json"}
    assert set(GaussiansHandler.bl_file_extensions.split(";")) == dropped


def test_the_axis_that_a_file_says_is_up(blender: ModuleType, engine, ply: Path) -> None:
    """nerfstudio's z; another one that was chosen wins."""
    means = read_ply(ply)["means"]
    said = b"\ncomment Vertical Axis: z\nelement"
    ply.write_bytes(ply.read_bytes().replace(b"\nelement", said, 1))
    np.testing.assert_allclose(points(bring(blender, ply)), means, atol=1e-6)
    turned = means @ turn("y", "z")[:3, :3].T
    np.testing.assert_allclose(points(bring(blender, ply, up="Y")), turned, atol=1e-6)


def test_out_and_in_again_is_the_same(blender: ModuleType, engine, ply: Path, tmp_path) -> None:
    item = bring(blender, ply, up="Z")
    np.testing.assert_allclose(points(item), read_ply(ply)["means"], atol=1e-6)
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "same.ply"), up="Z")
    np.testing.assert_array_equal(read_ply(tmp_path / "same.ply")["means"], read_ply(ply)["means"])
    item.location, item.rotation_euler, item.scale = (1, 2, 3), (0.3, 0.2, 0.1), (2, 2, 2)
    blender.context.view_layer.update()
    before = points(item)
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "out.ply"))
    again = bring(blender, tmp_path / "out.ply")
    np.testing.assert_allclose(points(again), before, atol=1e-5)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_out_and_in_again_it_is_made_for_the_same(
    blender: ModuleType, engine, tmp_path: Path, target: Target
) -> None:
    from roigs_addon.scene.splat_attributes import cloud_of

    write_ply(tmp_path / "vase.ply", random_arrays(20, seed=3), target)
    item = bring(blender, tmp_path / "vase.ply")
    assert target_of(item.roigs.ply) == target
    assert cloud_of(item.data)[0].target == target
    item.rotation_euler = (0.3, 0.2, 0.1)
    item.data.vertices[0].co.x += 0.1  # an edit: exported from a file of its own
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "out.ply"))
    assert target_of(tmp_path / "out.ply") == target
    assert cloud_of(bring(blender, tmp_path / "out.ply").data)[0].target == target


def test_the_panel_warns_of_formats_that_cannot_say_it(
    blender: ModuleType, engine, tmp_path: Path
) -> None:
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    write_ply(tmp_path / "vase.ply", random_arrays(20, seed=3), target=VIEWERS)
    bring(blender, tmp_path / "vase.ply")
    for name, warned in (("a.ply", False), ("b.splat", True), ("c.ply", False)):
        blender.ops.roigs.export_gaussians(filepath=str(tmp_path / name))
        texts = " ".join(said(blender, ResultPanel)).lower()
        assert f"exported {name}" in texts and ("anti-alias" in texts) == warned


def test_other_axes_and_the_frame_of_the_model(
    blender: ModuleType, engine, ply: Path, project: Path
) -> None:
    with pytest.raises(RuntimeError, match="There are no cameras"):
        bring(blender, ply, up="COLMAP")
    stored = read_ply(ply)["means"]
    for up in ("-y", "y"):
        turned = stored @ turn(up, "z")[:3, :3].T
        np.testing.assert_allclose(points(bring(blender, ply, up=up.upper())), turned, atol=1e-5)
    scene = imported(blender, project)
    scene.roigs.root.location = (5, 0, 0)
    blender.context.view_layer.update()
    item = bring(blender, ply, up="COLMAP")
    blender.context.view_layer.update()
    assert item.parent == scene.roigs.root
    place = np.array(scene.roigs.root.matrix_world)
    np.testing.assert_allclose(points(item), stored @ place[:3, :3].T + place[:3, 3], atol=1e-5)


@pytest.mark.exact_look
def test_it_is_rendered_and_exported_without_a_model(
    blender: ModuleType, engine, ply: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene.frame_request import frame_request

    scene = blender.context.scene
    item = bring(blender, ply)
    camera = blender.data.objects.new("Camera", blender.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0, -4, 0), (np.pi / 2, 0, 0)
    scene.camera = camera
    render = with_cycles(scene, samples=1)
    render.resolution_x, render.resolution_y, render.resolution_percentage = 96, 64, 100
    render.dither_intensity, render.filepath = 0.0, str(tmp_path / "f12.png")
    blender.ops.render.render(write_still=True)
    request = frame_request(scene, blender.context.evaluated_depsgraph_get(), "")
    assert request["models"][0]["ply"] == item.roigs.ply
    assert load_rgba(Path(render.filepath))[..., 3].max() > 0.5
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": [request["camera"]]}))
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "all.ply"), up="Z")
    out = tmp_path / "frames"
    command_line(engine, "render", tmp_path / "all.ply", "--path", path, "--out", out)
    f12, (picture,) = load_rgba(Path(render.filepath)), out.rglob("*.png")
    difference = f12[..., :3] * f12[..., 3:] - load_png(picture)
    assert -10 * np.log10(np.square(difference).mean() + 1e-12) > 40


def test_saved_and_opened_again(blender: ModuleType, engine, ply: Path, tmp_path: Path) -> None:
    """The file is in the run folder beside the .blend, and the object's points are enough."""
    from roigs_addon.scene import edits
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    blend = tmp_path / "my scene.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(blend))
    item = bring(blender, ply)
    copy = bring(blender, ply)
    name, own = item.name, Path(item.roigs.ply)
    assert own.is_relative_to(tmp_path / "my scene_roigs") and own != Path(copy.roigs.ply)
    assert not own.is_relative_to(blender.app.tempdir)
    ply.unlink()
    blender.ops.wm.save_mainfile()
    blender.ops.wm.read_homefile(use_empty=True)
    blender.ops.wm.open_mainfile(filepath=str(blend))
    item = blender.context.scene.objects[name]
    assert edits.file_of(item) == str(own) and item.roigs.level == "IMPORTED"
    before = read_ply(own)
    own.unlink()
    blender.ops.wm.open_mainfile(filepath=str(blend))
    item = blender.context.scene.objects[name]
    after = read_ply(edits.file_of(item))
    for key, values in before.items():
        if key != "quats":  # of length 1 now
            np.testing.assert_allclose(after[key], values, atol=2e-4, err_msg=key)
    assert not any("Missing" in line for line in said(blender, ResultPanel))


def test_of_a_file_that_was_never_saved(blender: ModuleType, engine, ply: Path) -> None:
    from roigs_addon import settings

    item = bring(blender, ply)
    assert Path(item.roigs.ply).is_relative_to(settings.unsaved_folder())
    assert blender.context.scene.roigs.run_dir


def test_results_come_and_go_beside_it(blender: ModuleType, run, engine, ply: Path) -> None:
    from roigs_addon.scene import compared, splats

    scene, folder = run
    blender.ops.roigs.load_results()
    item = bring(blender, ply)
    blender.ops.roigs.load_results()
    compared.switch(scene, folder)
    splats.show_preview(scene, folder / "result.ply")
    assert item.visible_get() and not item.hide_render  # also if the training is stopped now
    splats.remove_preview(scene)
    assert item.name in scene.objects and not item.hide_render and not item.hide_get()
    assert not item.roigs.parked


def test_in_the_panel_by_name(blender: ModuleType, engine, ply: Path) -> None:
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    bring(blender, ply)
    assert any("My vase" in line for line in said(blender, ResultPanel))


def test_it_is_selected_unless_something_is_edited(blender: ModuleType, engine, ply: Path) -> None:
    blender.ops.mesh.primitive_monkey_add()
    monkey = blender.context.object
    item = bring(blender, ply)
    assert blender.context.selected_objects == [item] and blender.context.object == item
    blender.context.view_layer.objects.active = monkey
    blender.ops.object.mode_set(mode="EDIT")
    bring(blender, ply)
    assert monkey.mode == "EDIT" and blender.context.object == monkey
    blender.ops.object.mode_set(mode="OBJECT")


def test_its_origin_is_its_middle(blender: ModuleType, engine, tmp_path: Path) -> None:
    """To turn it, and to find it with numpad `.`: objects lie anywhere in the frame of a scene."""
    arrays = random_arrays(200, seed=4)
    arrays["means"] += [5, 6, 7]
    write_ply(tmp_path / "far.ply", arrays)
    item = bring(blender, tmp_path / "far.ply", up="Z")
    blender.context.view_layer.update()
    np.testing.assert_allclose(points(item), arrays["means"], atol=1e-5)
    low, high = np.quantile(arrays["means"], (0.02, 0.98), axis=0)
    np.testing.assert_allclose(item.location, (low + high) / 2, atol=1e-4)


def test_map_coordinates_are_warned_of(blender: ModuleType, engine, tmp_path: Path) -> None:
    """The file's doubles do not fit into Blender's 32-bit numbers."""
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import IMPORTING_GAUSSIANS

    arrays = random_arrays(200, seed=4)
    arrays["means"] = arrays["means"].astype(np.float64)
    for name, origin in (("near", (5, 6, 7)), ("far", (5e5, 5e6, 100))):
        write_ply(tmp_path / f"{name}.ply", {**arrays, "means": arrays["means"] + origin})
        bring(blender, tmp_path / f"{name}.ply", up="Z")
        warnings = current.warnings(IMPORTING_GAUSSIANS)
        assert len(warnings) == (name == "far")
    assert warnings[0].startswith("far lies 5,000,00") and "Move it to the origin" in warnings[0]


def test_files_that_are_none(blender: ModuleType, engine, tmp_path: Path) -> None:
    def refused(path: object, match: str) -> None:
        with pytest.raises(RuntimeError, match=match) as caught:
            blender.ops.roigs.import_gaussians(filepath=str(path))
        assert "Traceback" not in str(caught.value)

    refused("", "Give a filepath")
    refused(f"{tmp_path}/", "Give a filepath")
    refused(tmp_path / "gone.ply", "There is no file")
    (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    refused(tmp_path / "a.ply", "a.ply")
    (tmp_path / "a.txt").write_text("no")
    refused(tmp_path / "a.txt", "not the name of a file of Gaussians")
    assert not [item for item in blender.context.scene.objects if item.roigs.kind == "SPLATS"]


def test_a_missing_package_is_said(
    blender: ModuleType, addon, ply: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the words of the engine, and what to do in Blender."""

    def missing(name: str, package: str | None = None) -> None:
        raise ImportError(f"No module named '{name}'")

    monkeypatch.setattr(machine, "import_module", missing)
    with pytest.raises(EngineError) as caught:
        machine.package("gsply", "SPZ")
    error = caught.value
    event = f"event='failed', message={error.message!r}, hint={error.hint!r}"
    use(monkeypatch, tmp_path, f"say({event}); sys.exit(2)")
    wanted = r"Run: pip install gsply \(Blender: set up the engine again\)"
    with pytest.raises(RuntimeError, match=wanted):
        blender.ops.roigs.import_gaussians(filepath=str(ply))


def test_the_menu_and_the_drop(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.operators import import_gaussians

    drawn = blender.types.TOPBAR_MT_file_import._dyn_ui_initialize()
    assert import_gaussians.menu_entry in drawn
    assert not import_gaussians.GaussiansHandler.poll_drop(blender.context)  # no 3D view here
