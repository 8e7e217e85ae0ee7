"""Stand Here: where a mesh stands after a click, and what the scene gets with it."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.fake_engine import fake
from tests.addon.stage_cases import CODE, flat_floor, own_things, state, write_panorama
from tests.addon.surface_cases import CENTRE, write_ball

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]


@pytest.fixture
def standing(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A scene with a floor of Gaussians and a cube, and the commands that the engine got."""
    from roigs_addon import settings
    from roigs_engine.formats.splat_ply import write_ply
    from roigs_engine.formats.targets import VIEWERS

    scene, folder = run
    write_ply(folder / "background.ply", flat_floor(), target=VIEWERS)
    blender.ops.roigs.load_results()
    scene.roigs.root.matrix_world.identity()  # the floor is at z = 0 of the model
    scene.roigs.root.rotation_mode = "XYZ"
    scene.roigs.root.rotation_euler = (0, 0, 0)
    blender.context.view_layer.update()
    scene.render.engine = "CYCLES"
    own_things(blender, scene)
    made, arguments = tmp_path / "made", tmp_path / "arguments"
    write_ball(made / "background.glb", radius=0.5)
    write_panorama(blender, made / "panorama.hdr")
    code = CODE
    for name, path in (("ARGUMENTS", arguments), ("MADE", made), ("RUN", folder)):
        code = code.replace(f'"{name}', f'"{path}')
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    blender.ops.mesh.primitive_cube_add(size=0.3, location=(5, 5, 5))
    cube = blender.context.object
    return scene, cube, lambda: [json.loads(row) for row in arguments.read_text().splitlines()]


def corners(item) -> np.ndarray:
    """(8, 3) of an object in the world."""
    import bpy

    bpy.context.view_layer.update()
    return np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])


def test_its_bottom_is_on_the_gaussians(blender: ModuleType, standing) -> None:
    scene, cube, given = standing
    point, eye = (1.52, -1.48, 0.0), (1.52, -4.0, 3.0)
    assert blender.ops.roigs.stand_here(point=point, eye=eye) == {"FINISHED"}
    found = corners(cube)
    assert found[:, 2].min() == pytest.approx(0.0, abs=2e-3)
    assert found.mean(axis=0)[:2] == pytest.approx(point[:2], abs=0.02)
    assert [command[0] for command in given()] == ["surface", "panorama"]
    at = next(part for part in given()[1] if part.startswith("--at=")).removeprefix("--at=")
    assert [float(n) for n in at.split(",")] == pytest.approx(found.mean(axis=0), abs=0.02)
    assert any(part.startswith("--near=0.15") for part in given()[1])
    names = sorted(item.name for item in scene.roigs.stage.collection.objects)
    assert {"Background Proxy", "Plane Proxy"} <= set(names)
    assert scene.world == scene.roigs.stage.world


def test_on_a_mesh_it_is_turned_to_its_normal(blender: ModuleType, standing) -> None:
    _, cube, _ = standing
    blender.ops.roigs.catch_shadows()
    away = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    point, eye = CENTRE + 0.5 * away, CENTRE + 4 * away
    blender.ops.roigs.stand_here(point=point.tolist(), eye=eye.tolist())
    up = np.array(cube.matrix_world.to_3x3().normalized().col[2])
    assert up @ away > np.cos(np.radians(8))
    heights = (corners(cube) - CENTRE) @ up
    assert heights.min() == pytest.approx(0.48, abs=0.04)
    assert "Plane Proxy" not in blender.data.objects
    blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    assert corners(cube)[:, 2].min() == pytest.approx(0.0, abs=2e-3), "upright again"
    assert np.ptp(corners(cube)[:, 2]) == pytest.approx(0.3, abs=0.01)


def test_remove_leaves_the_object_and_nothing_else(blender: ModuleType, standing) -> None:
    scene, _, _ = standing
    before = state(blender, scene)
    blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    blender.ops.roigs.stand_here(point=(1.0, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    blender.ops.roigs.remove_stage()
    assert state(blender, scene) == before


def test_one_undo_takes_all_back(blender: ModuleType, standing) -> None:
    scene, _, _ = standing
    before = state(blender, scene)
    blender.ops.ed.undo_push(message="before")
    blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    blender.ops.ed.undo_push(message="Stand Here")
    blender.ops.ed.undo()
    scene = blender.context.scene
    assert state(blender, scene) == before
    assert corners(scene.objects["Cube"]).mean(axis=0) == pytest.approx([5, 5, 5], abs=1e-4)


def during_the_job(monkeypatch: pytest.MonkeyPatch, act) -> None:
    """Have `act` called while the engine works."""
    from roigs_addon.jobs import current

    wait = current.wait

    def acted(job):
        act()
        return wait(job)

    monkeypatch.setattr(current, "wait", acted)


def test_moved_meanwhile_it_stays_there(
    blender: ModuleType, standing, monkeypatch: pytest.MonkeyPatch
) -> None:
    def move() -> None:
        cube.location = (4, 4, 4)
        blender.context.view_layer.update()

    _, cube, given = standing
    during_the_job(monkeypatch, move)
    blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    assert corners(cube).mean(axis=0) == pytest.approx([4, 4, 4], abs=1e-4) and given()


def test_deleted_meanwhile(blender: ModuleType, standing, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, cube, _ = standing
    during_the_job(monkeypatch, lambda: blender.data.objects.remove(cube))
    blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    assert scene.world == scene.roigs.stage.world


def test_in_another_scene_meanwhile(
    blender: ModuleType, standing, monkeypatch: pytest.MonkeyPatch
) -> None:
    def switch() -> None:
        blender.context.window.scene = other
        blender.context.view_layer.update()

    scene, cube, _ = standing
    other = blender.data.scenes.new("other")
    during_the_job(monkeypatch, switch)
    x, y, _ = CENTRE
    blender.ops.roigs.stand_here(point=(x, y, 0.0), eye=(x, y, 4.0))
    assert blender.context.scene == other and other.roigs.stage.collection is None
    blender.context.window.scene = scene
    names = {item.name for item in scene.roigs.stage.collection.objects}
    assert "Background Proxy" in names
    assert corners(cube)[:, 2].min() == pytest.approx(CENTRE[2] + 0.5, abs=0.05), "on the mesh"


def test_without_an_engine_it_stands_and_says_why(
    blender: ModuleType, standing, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.errors import AddonError

    def none(_: object) -> None:
        raise AddonError("No engine. Set it up.")

    _, cube, _ = standing
    monkeypatch.setattr(settings, "engine", none)
    with pytest.raises(RuntimeError, match="No engine"):
        blender.ops.roigs.stand_here(point=(1.5, -1.5, 0.0), eye=(1.5, -4.0, 3.0))
    assert corners(cube)[:, 2].min() == pytest.approx(0.0, abs=2e-3)


def test_where_there_is_nothing(blender: ModuleType, standing) -> None:
    scene, cube, _ = standing
    for item in scene.objects:
        if item.roigs.kind in ("SPLATS", "POINTS"):
            item.hide_viewport = True
    with pytest.raises(RuntimeError, match="no captured surface"):
        blender.ops.roigs.stand_here(point=(90, 90, 90), eye=(99, 90, 90))
    assert corners(cube).mean(axis=0) == pytest.approx([5, 5, 5])
    blender.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="Select a mesh"):
        blender.ops.roigs.stand_here(point=(0, 0, 0))
