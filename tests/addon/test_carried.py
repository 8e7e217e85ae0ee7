"""A .blend that carries its Gaussians: without the run folder, in another Blender."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply
from tests.addon.other_blender import other_blender
from tests.addon.panels import said
from tests.addon.pictures import load_rgba
from tests.addon.results import set_aside
from tests.addon.scenes import ROOT, with_cycles
from tests.addon.splat_cases import random_ply

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]

BLENDER_SCRIPT = """
import sys
from contextlib import suppress
sys.path.insert(0, {root!r})
import bpy
import roigs_addon
from roigs_addon.scene import native_splats
from roigs_addon.viewport.objects import marked
native_splats.exist = lambda: False  # as the mark exact_look
with suppress(ImportError):
    from roigs_addon.engine.command import Engine
    from tests import warm_engine
    Engine.command = warm_engine.quick(Engine.command)
roigs_addon.register()
bpy.ops.wm.open_mainfile(filepath={blend!r})
scene = bpy.context.scene
scene.render.compositor_device = "CPU"  # a fresh Blender without a window looks for a GPU
scene.render.filepath = {picture!r}
bpy.ops.render.render(write_still=True)
print("VIEWPORT", sum(item.visible for item in marked(scene.objects)))
print(bpy.ops.roigs.export_gaussians(filepath={exported!r}, up="Z"))
roigs_addon.unregister()
"""


@pytest.fixture
def saved(blender: ModuleType, run, engine, tmp_path: Path):
    """A scene with results and its render, and its .blend; the run folder is below it."""
    bpy, (scene, folder) = blender, run
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.look_through(photo="photo 3.png")
    scene.objects["thing Gaussians"].rotation_euler = (0.2, 0.4, 0.1)
    render = with_cycles(scene, samples=1)
    render.dither_intensity, render.filepath = 0.0, str(tmp_path / "before.png")
    bpy.ops.render.render(write_still=True)
    blend = tmp_path / "carried.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    return scene, folder, blend


def test_in_another_blender_without_its_run_folder(
    blender: ModuleType, saved, tmp_path: Path
) -> None:
    _, folder, blend = saved
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "before.ply"), up="Z")
    empty = tmp_path / "empty"
    empty.mkdir()
    values = {
        "root": str(ROOT),
        "blend": shutil.move(blend, empty / "moved.blend"),
        "picture": str(empty / "after.png"),
        "exported": str(empty / "after.ply"),
    }
    shutil.rmtree(folder)
    code = BLENDER_SCRIPT.format(**{key: str(value) for key, value in values.items()})
    with other_blender(tmp_path, code) as process:
        output, _ = process.communicate(timeout=300)
    assert "VIEWPORT 2" in output and "ROI-GS:" not in output, output
    before, after = load_rgba(tmp_path / "before.png"), load_rgba(empty / "after.png")
    assert before.std() > 0.05
    assert -10 * np.log10(np.square(after - before).mean() + 1e-12) > 45
    kept, expected = read_ply(empty / "after.ply"), read_ply(tmp_path / "before.ply")
    assert expected["sh"].shape[1] == 16
    for name, values in expected.items():
        np.testing.assert_allclose(kept[name], values, atol=2e-4, err_msg=name)


def drawn(scene) -> set[Path]:
    from roigs_addon.viewport.objects import marked

    return {Path(item.file.path) for item in marked(scene.objects) if item.visible}


def test_a_folder_that_was_moved_is_found(blender: ModuleType, saved, tmp_path: Path) -> None:
    """Its parent is enough; the settings follow."""
    from roigs_addon.facts import run_facts

    scene, folder, _ = saved
    moved = tmp_path / "archive" / "vase"
    moved.parent.mkdir()
    folder.rename(moved)
    assert len(run_facts.lost_splats(scene)) == 3
    with pytest.raises(RuntimeError, match="has none of the models"):
        blender.ops.roigs.find_folder(directory=str(tmp_path / "empty"))
    assert blender.ops.roigs.find_folder(directory=str(moved.parent)) == {"FINISHED"}
    assert not run_facts.lost_splats(scene) and Path(scene.roigs.run_dir) == moved
    assert drawn(scene) == {moved / "background.ply", moved / "rois" / "thing.ply"}


def test_moved_together_an_earlier_result_stays_shown(
    blender: ModuleType, saved, tmp_path: Path
) -> None:
    """Not the last one, which the moved run folder has in its place."""
    _, folder, blend = saved
    older = set_aside(folder)
    shutil.copytree(older, folder, dirs_exist_ok=True)
    for seed, path in enumerate([folder / "background.ply", *folder.glob("[rc]o*/*.ply")]):
        random_ply(path, len(read_ply(path)["means"]), seed=50 + seed)
    away = tmp_path / "away"
    away.mkdir()
    shutil.move(blend, away)
    shutil.move(folder, away)
    blender.ops.wm.open_mainfile(filepath=str(away / blend.name))
    found = away / folder.name / "earlier" / older.name
    expected = {found / "background.ply", found / "rois" / "thing.ply"}
    assert drawn(blender.context.scene) == expected


def test_another_result_in_the_files_place_is_not_drawn(blender: ModuleType, saved) -> None:
    """Until it is loaded: a training in a terminal has replaced what is shown."""
    scene, folder, _ = saved
    path = folder / "background.ply"
    expected = read_ply(path)["means"]
    random_ply(path, len(expected), seed=99)
    assert path not in drawn(scene)
    (shown,) = (file for file in drawn(scene) if file.name != "thing.ply")
    np.testing.assert_allclose(read_ply(shown)["means"], expected, atol=1e-6)
    blender.ops.roigs.load_results()
    assert path in drawn(scene)


def colours(scene) -> int:
    from roigs_addon.scene.splat_attributes import SH_NAMES

    attributes = scene.objects["Background"].data.attributes
    return sum(attribute.name in SH_NAMES for attribute in attributes)


def hide_first(scene, hide: bool = True) -> None:
    scene.objects["Background"].data.vertices[0].hide = hide


def test_saved_without_view_dependent_colour(blender: ModuleType, saved) -> None:
    """A third of the size; the PLY gives the colour back, except to points that were edited."""
    from roigs_addon.scene import edits
    from roigs_addon.ui.result import ResultPanel

    bpy, (scene, folder, blend) = blender, saved
    path = folder / "background.ply"
    random_ply(path, 2000, seed=3)
    bpy.ops.roigs.load_results()
    bpy.ops.wm.save_mainfile()
    large = blend.stat().st_size
    scene.roigs.carry_colour = False
    bpy.ops.wm.save_mainfile()
    assert large - blend.stat().st_size > 2000 * 45 * 4 * 0.95
    assert colours(scene) == 15, "only the file is without"
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    assert colours(scene) == 15 and drawn(scene) == {path, folder / "rois" / "thing.ply"}
    hide_first(scene)  # such points are only in the .blend
    bpy.ops.wm.save_mainfile()
    away = path.rename(path.with_name("away.ply"))
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    assert colours(scene) == 15
    hide_first(scene, False)
    away.rename(path)
    bpy.ops.wm.save_mainfile()
    away = path.rename(path.with_name("away.ply"))
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    assert colours(scene) == 0
    told = " ".join(said(bpy, ResultPanel))
    assert "1 model is drawn from the .blend, without view-dependent colour" in told
    flat = read_ply(edits.file_of(scene.objects["Background"]))
    np.testing.assert_allclose(flat["sh"], read_ply(away)["sh"][:, :1], atol=1e-6)
    folder.rename(folder.with_name("moved"))
    (folder.with_name("moved") / "away.ply").rename(folder.with_name("moved") / "background.ply")
    bpy.ops.roigs.find_folder(directory=str(folder.with_name("moved")))
    assert colours(scene) == 15
