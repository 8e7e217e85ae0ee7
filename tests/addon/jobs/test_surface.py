"""Make Surface: the engine makes meshes in the run folder, which are then in the scene."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.fake_engine import LISTEN, fake, until, use
from tests.addon.panels import said
from tests.addon.scenes import add_box, ready
from tests.addon.surface_cases import write_ball

pytestmark = pytest.mark.blender

CODE = """
from pathlib import Path
Path("ARGUMENTS").write_text(json.dumps(sys.argv[1:]))
say(event="stagestarted", stage="depth", total=9)
for path in Path("MADE").iterdir():
    (Path("RUN") / "rois" / path.name).write_bytes(path.read_bytes())
say(event="done", outputs={"thing": str(Path("RUN") / "rois" / "thing.glb")})
"""


@pytest.fixture
def made(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A scene, a file of what the engine makes, and the arguments that it gets."""
    from roigs_addon import settings

    scene, folder = run
    names = {"ARGUMENTS": tmp_path / "arguments", "MADE": tmp_path / "made", "RUN": folder}
    write_ball(names["MADE"] / "thing.glb")
    code = CODE
    for name, path in names.items():
        code = code.replace(f'"{name}"', repr(str(path)))
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    return scene, names["MADE"] / "thing.glb", names["ARGUMENTS"]


def panel(bpy: ModuleType) -> list[str]:
    from roigs_addon.ui import surface

    return said(bpy, surface.SurfacePanel)


def test_a_mesh_comes_into_the_place_of_the_gaussians(blender: ModuleType, made) -> None:
    scene, _, arguments = made
    scene.roigs.watertight, scene.roigs.faces = True, 5000
    assert "Make a mesh to light, print or measure an object" in " ".join(panel(blender))
    assert blender.ops.roigs.make_surface() == {"FINISHED"}
    given = json.loads(arguments.read_text())
    assert given[:3] == ["surface", scene.roigs.run_dir, "--only=thing"]
    assert {"--watertight", "--faces=5000", "--device"} <= set(given)
    item, gaussians = scene.objects["thing Mesh"], scene.objects["thing Gaussians"]
    assert gaussians.hide_render and not item.hide_render
    labels = panel(blender)
    assert {"thing Mesh", "Gaussians", "Mesh", "Both"} <= set(labels)
    facts = " ".join(labels)
    assert "528 faces, 40 cm × 40 cm × 40 cm, closed" in facts and "3.0% filled" in facts
    assert "Made 1 surface" in facts


def test_all_boxes(blender: ModuleType, made) -> None:
    _, _, arguments = made
    add_box(blender, "another", (-1, -1, -1), (1, 1, 1))
    assert blender.ops.roigs.make_surface(every=True) == {"FINISHED"}
    assert not any(part.startswith("--only") for part in json.loads(arguments.read_text()))


def test_sizes_are_those_of_the_scene(blender: ModuleType, made) -> None:
    scene, _, _ = made
    blender.ops.roigs.make_surface()
    scene.roigs.root.scale = (10, 10, 10)
    blender.context.view_layer.update()
    assert "4 m × 4 m × 4 m" in " ".join(panel(blender))
    scene.unit_settings.system = "NONE"
    assert "4 × 4 × 4, closed" in " ".join(panel(blender))


def test_edits_are_warned_of(blender: ModuleType, made) -> None:
    scene, source, arguments = made
    blender.ops.roigs.make_surface()
    item = scene.objects["thing Mesh"]
    item.data.vertices[0].co.x += 1
    item.data.update()
    blender.context.view_layer.update()
    assert any("'thing Mesh' was edited" in label for label in panel(blender))
    assert "Make Surface: thing" in panel(blender)
    arguments.unlink()
    with pytest.raises(RuntimeError, match=r"'thing Mesh' was edited .* replace_edits=True"):
        blender.ops.roigs.make_surface()
    assert not arguments.exists()
    write_ball(source, radius=0.3)
    assert blender.ops.roigs.make_surface(replace_edits=True) == {"FINISHED"}
    assert scene.objects["thing Mesh"] == item and item.dimensions.x == pytest.approx(0.6, abs=0.02)
    assert not any("edited" in label for label in panel(blender))


def test_an_edit_meanwhile_is_kept(blender: ModuleType, made) -> None:
    from roigs_addon.jobs import current, surface_job

    scene, _, _ = made
    blender.ops.roigs.make_surface()
    item = scene.objects["thing Mesh"]
    from roigs_addon import settings

    job = current.start(settings.engine(()), surface_job.spec(scene, [], replace_edits=False))
    item.data.vertices[0].co.x += 1
    blender.context.view_layer.update()
    item.data.update()
    mesh = item.data
    assert until(lambda: not job.poll())
    assert "was edited since it was made" in job.state.error and item.data == mesh


def test_it_stops(blender: ModuleType, run, tmp_path: Path, monkeypatch) -> None:
    from roigs_addon import settings
    from roigs_addon.engine.run_status import RunStatus
    from roigs_addon.facts import run_facts
    from roigs_addon.jobs import current, surface_job
    from roigs_addon.ui import train

    scene, _ = run
    use(monkeypatch, tmp_path, LISTEN)
    job = current.start(settings.engine(()), surface_job.spec(scene, [], replace_edits=False))
    assert until(lambda: job.poll() and job.state.stage == "scene")
    holds = RunStatus(result=True, holder=1234)  # the lock of this engine
    monkeypatch.setattr(run_facts, "run", lambda _: holds)
    assert not any("Another Blender" in label for label in said(blender, train.TrainPanel))
    job.stop()
    assert until(lambda: not job.poll())
    assert job.result.stopped and current.stopped() and "thing Mesh" not in scene.objects
    assert any("Another Blender" in label for label in said(blender, train.TrainPanel))


def test_what_is_finished_is_shown_after_a_stop(
    blender: ModuleType, run, tmp_path: Path, monkeypatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.jobs import current, surface_job

    scene, folder = run
    blender.ops.roigs.load_results()
    write_ball(folder / "rois" / "other.glb")  # from before
    code = (
        f"import shutil, time; shutil.copytree({str(tmp_path / 'made')!r},"
        f" {str(folder / 'rois')!r}, dirs_exist_ok=True)\n"
    )
    write_ball(tmp_path / "made" / "thing.glb")
    use(monkeypatch, tmp_path, code + LISTEN)
    job = current.start(settings.engine(()), surface_job.spec(scene, [], replace_edits=False))
    assert until(lambda: job.poll() and job.state.stage == "scene")
    job.stop()
    assert until(lambda: not job.poll())
    assert job.result.stopped and not job.state.error
    assert not scene.objects["thing Mesh"].hide_render and "other Mesh" not in scene.objects
    assert scene.objects["thing Gaussians"].hide_render


def test_the_box_is_that_of_the_active_gaussians(blender: ModuleType, made) -> None:
    scene, _, arguments = made
    add_box(blender, "another", (-1, -1, -1), (1, 1, 1))
    assert "Make Surface: another" in panel(blender)
    blender.ops.roigs.load_results()
    blender.ops.roigs.select_gaussians(name="thing Gaussians")
    assert "Make Surface: thing" in panel(blender)
    scene.roigs.texture_size = 512
    blender.ops.roigs.make_surface()
    assert {"--only=thing", "--texture-size=512"} <= set(json.loads(arguments.read_text()))
    assert "Make Surface: thing" in panel(blender)  # though its Gaussians are hidden now


def test_a_moved_project_is_named(blender: ModuleType, made) -> None:
    scene, _, arguments = made
    settings = Path(scene.roigs.run_dir) / "settings.json"
    settings.write_text(json.dumps({"scene": scene.roigs.colmap}))
    blender.ops.roigs.make_surface()
    assert not any(part.startswith("--scene") for part in json.loads(arguments.read_text()))
    settings.write_text(json.dumps({"scene": "/gone/garden"}))
    blender.ops.roigs.make_surface()
    assert f"--scene={scene.roigs.colmap}" in json.loads(arguments.read_text())


def test_without_the_packages_the_set_up_is_named(
    blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.engine import python

    lacks = python.Ability(version=(3, 12), missing=("skimage", "trimesh"))
    monkeypatch.setattr(python, "ability", lambda path: lacks)
    with pytest.raises(RuntimeError, match=r"lacks skimage, trimesh.* preferences"):
        blender.ops.roigs.make_surface()


def test_a_preview_hides_it_meanwhile(blender: ModuleType, made) -> None:
    from roigs_addon.scene import splats

    scene, source, _ = made
    blender.ops.roigs.make_surface()
    item, gaussians = scene.objects["thing Mesh"], scene.objects["thing Gaussians"]
    splats.show_preview(scene, source)
    assert item.hide_viewport and not item.hide_render
    splats.remove_preview(scene)
    assert not item.hide_viewport and gaussians.hide_viewport


def test_a_renamed_box_is_found(blender: ModuleType, made) -> None:
    from roigs_addon.scene import splats

    scene, _, _ = made
    blender.ops.roigs.make_surface()
    splats.rename_boxes(scene, {"thing": "pot"})
    assert scene.objects["pot Mesh"].roigs.roi == "pot"
    assert scene.objects["pot Gaussians"].roigs.roi == "pot"


def test_a_surface_of_a_training(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    for name in ("skimage", "fast_simplification", "trimesh"):
        pytest.importorskip(name)
    scene = ready(blender, project, tmp_path / "run", factor=0.02)
    blender.ops.roigs.train_roi()
    scene.roigs.root.scale = (3, 3, 3)
    blender.context.view_layer.update()
    assert blender.ops.roigs.make_surface() == {"FINISHED"}
    item = scene.objects["thing Mesh"]
    blender.context.view_layer.update()
    box = np.linalg.inv(np.array(scene.objects["thing"].matrix_world))
    corners = np.c_[np.array(item.bound_box), np.ones(8)]
    inside = corners @ np.array(item.matrix_world).T @ box.T
    assert (np.abs(inside[:, :3]) < 1.1).all() and len(item.data.polygons) > 10
