"""Train gives what the engine's command line gives."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from types import ModuleType

import pytest

from roigs_engine.formats.run_files import BACKGROUND, MANIFEST
from roigs_engine.formats.stage_list import read_stage_list
from tests.addon.scenes import (
    add_box,
    command_line,
    imported,
    listed_stage,
    options,
    ready,
    record,
    start_training,
    status,
)

pytestmark = pytest.mark.blender


def plys(folder: Path) -> dict[str, bytes]:
    """All results of a run."""
    paths = [*folder.glob("*.ply"), *folder.glob("rois/*.ply"), *folder.glob("coarse/*.ply")]
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in paths
        if path.name != "preview.ply"
    }


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory):
    """Results of the engine's command line on an options file, made once for each file."""
    done: dict[str, Path] = {}

    def results(engine, values: dict) -> dict[str, bytes]:
        values = {k: v for k, v in values.items() if k not in ("update", "preview_seconds")}
        key = json.dumps(values | {"rois": Path(values["rois"]).read_text("utf-8")})
        if key not in done:
            folder = tmp_path_factory.mktemp("by hand")
            (folder / "options.json").write_text(json.dumps(values), encoding="utf-8")
            command_line(engine, "train", folder / "options.json", "--run-dir", folder / "run")
            done[key] = folder / "run"
        return plys(done[key])

    return results


def test_the_result_is_the_engines(
    blender: ModuleType, engine, project: Path, tmp_path: Path, by_hand
) -> None:
    bpy = blender
    scene = ready(bpy, project, tmp_path / "run")
    assert bpy.ops.roigs.train_roi() == {"FINISHED"}
    results = plys(tmp_path / "run")
    assert {"result.ply", BACKGROUND, "rois/thing.ply", "coarse/thing.ply"} == set(results)
    assert results == by_hand(engine, options(tmp_path / "run", "train"))
    # Options by hand instead of the options file.
    boxes = tmp_path / "run" / "blender" / "rois.json"
    arguments = ["--rois", boxes, "--max-side", 640, "--test-every", 0, "--steps-factor", 0.004]
    arguments += ["--made-for", scene.roigs.made_for]
    command_line(engine, "train", project, *arguments, "--run-dir", tmp_path / "2")
    assert plys(tmp_path / "2") == results
    # A root that is turned and scaled, the box with it.
    scene.roigs.root.scale = 3, 3, 3
    scene.roigs.root.rotation_quaternion = 0.5, 0.1, -0.7, 0.4
    scene.roigs.root.location = 5, 6, 7
    scene.roigs.run_dir = str(tmp_path / "3")
    bpy.context.view_layer.update()
    assert bpy.ops.roigs.train_roi() == {"FINISHED"}
    assert plys(tmp_path / "3") == results


def test_a_list_of_photos_is_used(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    bpy, run = blender, tmp_path / "run"
    ready(bpy, project, run)
    for name in ("photo 6.png", "photo 1.png"):
        bpy.ops.roigs.edit_selection(action="ADD", photo=name)
    bpy.ops.roigs.train_roi()
    record = json.loads((run / "selection" / "thing.json").read_text(encoding="utf-8"))
    assert record["names"] == ["photo 6.png", "photo 1.png"] and record["method"] == "manual"


def test_the_whole_scene_is_reused_for_another_box(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup

    bpy, run = blender, tmp_path / "run"
    scene = ready(bpy, project, run)
    bpy.ops.roigs.train_roi()
    assert set(status(scene).done) == {"joint", "scene"} and not status(scene).left
    made = read_stage_list(run)["scene"] / "stage.json"
    before = made.stat().st_mtime_ns
    add_box(bpy, "second", (-0.5, -0.5, -0.5), (0.0, 0.1, 0.2))
    bpy.ops.roigs.train_roi(active_only=True)
    now = read_stage_list(run)["scene"] / "stage.json"
    assert now == made and now.stat().st_mtime_ns == before
    assert [path.stem for path in (run / "rois").iterdir()] == ["second"]
    # The first box keeps the Gaussians it had.
    levels = {(o.roigs.level, o.roigs.roi) for o in lookup.splats(scene)}
    assert ("ROI", "second") in levels


def test_a_renamed_box_is_not_trained_again(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.facts import outdated
    from roigs_addon.jobs import current

    bpy, run = blender, tmp_path / "run"
    scene = ready(bpy, project, run)
    add_box(bpy, "second", (-0.5, -0.5, -0.5), (0.0, 0.1, 0.2))
    scene.roigs.strategy = "independent"
    bpy.ops.roigs.train_roi()
    assert outdated.in_words(scene, status(scene)) == ""
    before, made = plys(run), read_stage_list(run)["object-thing"]
    item = scene.objects["thing Gaussians"]
    item.location.x = 7
    scene.objects["thing"].name = "a pot"  # now the first by name
    assert outdated.in_words(scene, status(scene)) == ""
    bpy.ops.roigs.train_roi()
    assert read_stage_list(run)["object-a pot"] == made
    names = {name: name if "stages" in name else name.replace("thing", "a pot") for name in before}
    assert plys(run) == {names[name]: data for name, data in before.items()}
    assert item.name == "a pot Gaussians" and item.location.x == 7
    assert item.roigs.ply == str(run / "rois" / "a pot.ply")
    assert not current.state().error


def test_with_test_photos_the_result_is_measured(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.facts import outdated, run_facts

    bpy, run = blender, tmp_path / "run"
    scene = ready(bpy, project, run)
    bpy.ops.roigs.train_roi()
    assert run_facts.result(scene).psnr == ""
    scene.roigs.test_every = 4
    assert "test photos: 1 in 4" in outdated.in_words(scene, status(scene))
    bpy.ops.roigs.train_roi()
    assert outdated.in_words(scene, status(scene)) == ""
    assert run_facts.result(scene).psnr.endswith(" dB on 2 test photos")
    (earlier,) = run_facts.earlier(scene)
    assert earlier.psnr == "" and earlier.settings.test_every == 0
    scene.roigs.test_every = 0
    text = outdated.in_words(scene, status(scene))
    assert text.endswith(". Train reuses the earlier result where it still fits")


def test_a_stopped_training_resumes_to_the_same_bytes(
    blender: ModuleType, engine, project: Path, tmp_path: Path, by_hand
) -> None:
    from roigs_addon.jobs import current

    bpy, run = blender, tmp_path / "run"
    scene = ready(bpy, project, run, factor=0.1)
    job = start_training(engine, scene)
    state = current.state()
    while job.poll() and not (state.stage in ("scene", "joint") and state.step > 0):
        time.sleep(0.02)
    assert job.poll(), "it ended before it could be stopped"
    bpy.ops.roigs.stop()
    while job.poll():
        time.sleep(0.02)
    assert job.result.stopped and not status(scene).result
    assert bpy.ops.roigs.train_roi() == {"FINISHED"}
    assert status(scene).result and not status(scene).left
    assert plys(run) == by_hand(engine, options(run, "train"))


def test_resuming_trains_the_same_boxes(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """Training others too would not go on with a stopped 'Only …'."""
    from roigs_addon.operators.train import TrainRoi

    class Asker:
        active_only = selected_only = False
        resume = True
        _boxes = TrainRoi._boxes

    bpy, run = blender, tmp_path / "run"
    scene = ready(bpy, project, run)
    for name, top in (("jug", 0.2), ("vase", 0.3)):
        add_box(bpy, name, (-0.5, -0.5, -0.5), (0.0, 0.1, top))

    def trained() -> list[str]:
        return [roi.name for roi in Asker()._boxes(bpy.context)]

    assert trained() == ["jug", "thing", "vase"]
    boxes = {"rois": [record(scene.objects["jug"], scene)]}
    joint = listed_stage(run, "joint")
    (run / MANIFEST).write_text(json.dumps(boxes), encoding="utf-8")
    assert trained() == ["jug", "thing", "vase"], "nothing was begun"
    (joint / "checkpoint.bin").touch()
    assert trained() == ["jug"]
    Asker.resume = False
    assert trained() == ["jug", "thing", "vase"]
    Asker.resume = True
    bpy.data.objects.remove(scene.objects["jug"])
    assert trained() == ["thing", "vase"]


def test_the_engines_error_is_the_operators(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current

    bpy = blender
    ready(bpy, project, tmp_path / "run")
    bpy.ops.roigs.edit_selection(action="ADD", photo="no such photo.png")
    with pytest.raises(RuntimeError, match=r"no such photo\.png") as error:
        bpy.ops.roigs.train_roi()
    assert "Traceback" not in str(error.value)
    assert "no such photo.png" in current.state().error
    assert bpy.ops.roigs.show_log() == {"FINISHED"}


def test_a_run_is_found_again_in_a_reopened_file(
    blender: ModuleType, engine, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current, run_folders
    from roigs_addon.scene import lookup

    bpy = blender
    scene = imported(bpy, project)
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    scene.roigs.steps_factor = 0.004
    path = tmp_path / "für Anna.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert run_folders.run_folder(scene) == tmp_path / "für Anna_roigs"
    job = start_training(engine, scene)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    result = current.wait(job)
    assert not result.failed, result.message
    assert len(lookup.splats(bpy.context.scene)) == 3
    # And from a file that does not know the run, nothing is changed.
    scene = bpy.context.scene
    shutil.rmtree(tmp_path / "für Anna_roigs")
    job = start_training(engine, scene)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not current.wait(job).failed
    assert not lookup.splats(bpy.context.scene)
