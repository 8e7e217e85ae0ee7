"""Refine Cameras: the engine writes better cameras, which take the old ones' place."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_addon.engine.python import FOR_REFINING
from tests.addon.colmap_project import write_project
from tests.addon.fake_engine import fake, until, use
from tests.addon.scenes import add_box, imported, record

pytestmark = pytest.mark.blender

BEND, LEAN = -0.3, 0.05


@pytest.fixture
def scene(blender: ModuleType, addon: ModuleType, tmp_path: Path):
    """A scene whose photos have a lens that its cameras know nothing of, and whose poses lean."""
    project = write_project(tmp_path / "garden", bend=BEND)
    lean(project / "sparse" / "0" / "images.txt")
    return imported(blender, project)


def lean(images: Path) -> None:
    """Move the cameras of a text model back a little."""
    lines = images.read_text().splitlines()
    for row in range(0, len(lines), 2):
        number, *pose, camera, photo = lines[row].split(maxsplit=9)
        pose[6] = f"{float(pose[6]) + LEAN:.17g}"
        lines[row] = " ".join([number, *pose, camera, photo])
    images.write_text("\n".join(lines) + "\n")


@pytest.fixture
def steps(addon: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The undo steps of jobs."""
    from roigs_addon.jobs import undo

    made: list[str] = []
    monkeypatch.setattr(undo, "push", made.append)
    return made


@pytest.fixture
def refining(addon: ModuleType) -> None:
    """Skips where no engine can refine."""
    from roigs_addon import settings
    from roigs_addon.errors import AddonError

    try:
        settings.engine(FOR_REFINING)
    except AddonError as error:
        pytest.skip(str(error))


def panel(bpy: ModuleType) -> str:
    from roigs_addon.ui.scene import ScenePanel
    from tests.addon.panels import said

    return " ".join(said(bpy, ScenePanel))


def poses(scene) -> dict[str, np.ndarray]:
    from roigs_addon.scene import lookup

    return {name: lookup.photo_record(item).pose for name, item in lookup.cameras(scene).items()}


def test_the_refined_model_takes_the_old_ones_place(
    blender: ModuleType, scene, steps: list[str], refining: None, tmp_path: Path
) -> None:
    from roigs_addon.jobs import refine_job
    from roigs_addon.scene import lookup

    bpy, root = blender, scene.roigs.root
    root.location, root.scale = (1, 2, 3), (2, 2, 2)
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    scene.collection.objects.link(own)
    bpy.ops.roigs.look_through(photo="photo 4.png")
    before, box, old = root.matrix_world.copy(), record(scene.objects["thing"], scene), poses(scene)
    steps.clear()
    assert bpy.ops.roigs.refine_cameras() == {"FINISHED"}
    refined = tmp_path / "garden" / "sparse" / "refined"
    assert scene.roigs.colmap == str(refined) and steps == ["Refining"]
    new = poses(scene)
    assert new.keys() == old.keys()
    moved = [np.abs(new[name] - old[name]).max() for name in old]
    assert np.median(moved) > LEAN / 2
    assert scene.roigs.root == root and root.matrix_world == before
    assert record(lookup.rois(scene)[0], scene) == box
    assert own.name in scene.objects and scene.camera == lookup.cameras(scene)["photo 4.png"]
    text = panel(bpy)
    assert refine_job.REFINED in text and "garden: 8 photos" in text
    assert not bpy.ops.roigs.refine_cameras.poll()
    for colmap in (tmp_path / "garden", refined):  # undo, redo
        scene.roigs.colmap = str(colmap)
        assert (refine_job.REFINED in panel(bpy)) == (colmap == refined)
    with pytest.raises(RuntimeError, match="The cameras are refined already"):
        bpy.ops.roigs.refine_cameras()


def test_a_refined_model_is_used_again(
    blender: ModuleType, scene, refining: None, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current

    bpy, project = blender, tmp_path / "garden"
    bpy.ops.roigs.refine_cameras()
    refined, new = scene.roigs.colmap, poses(scene)
    changed = Path(refined, "images.bin").stat().st_mtime_ns
    for folder in (project, project / "sparse", project / "sparse" / "0"):
        imported(bpy, folder)
        root = scene.roigs.root
        root.location = 4, 5, 6
        bpy.context.view_layer.update()
        before = root.matrix_world.copy()
        assert bpy.ops.roigs.refine_cameras() == {"FINISHED"}
        assert scene.roigs.colmap == refined and root.matrix_world == before
        assert all(np.array_equal(pose, new[name]) for name, pose in poses(scene).items())
        assert current.state().outcome.startswith("The cameras were refined before")
    assert Path(refined, "images.bin").stat().st_mtime_ns == changed


def test_a_newer_model_is_not_replaced_by_an_old_refined_one(
    blender: ModuleType, scene, tmp_path: Path
) -> None:
    sparse = tmp_path / "garden" / "sparse"
    (sparse / "refined").mkdir()
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        (sparse / "refined" / name).touch()
        os.utime(sparse / "refined" / name, (1000, 1000))
    with pytest.raises(RuntimeError, match=r"is older than the model\. Delete it") as error:
        blender.ops.roigs.refine_cameras()
    assert "\n" not in str(error.value).strip()
    assert scene.roigs.colmap == str(tmp_path / "garden")


def test_cameras_that_fit_are_left(
    blender: ModuleType,
    scene,
    steps: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from roigs_addon.jobs import refine_job

    before = poses(scene)
    steps.clear()
    use(monkeypatch, tmp_path, "say(event='done', outputs={}, stopped=False)")
    assert blender.ops.roigs.refine_cameras() == {"FINISHED"}
    assert scene.roigs.colmap == str(tmp_path / "garden") and not steps
    assert poses(scene).keys() == before.keys()
    assert refine_job.FIT_ALREADY in panel(blender) and "8 photos" in panel(blender)
    assert blender.ops.roigs.refine_cameras.poll()


def test_errors_are_one_line(
    blender: ModuleType, scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "say(event='failed', message='It has too few points.', hint='Take more photos.')"
    use(monkeypatch, tmp_path, f"{code}\nsys.exit(2)")
    with pytest.raises(RuntimeError, match=r"too few points\. Take more photos") as error:
        blender.ops.roigs.refine_cameras()
    assert "\n" not in str(error.value).strip() and "Traceback" not in str(error.value)
    assert "It has too few points" in panel(blender)
    assert scene.roigs.colmap == str(tmp_path / "garden")
    scene.roigs.colmap = str(tmp_path / "gone")
    with pytest.raises(RuntimeError, match="no longer exists"):
        blender.ops.roigs.refine_cameras()


def test_it_needs_a_model(blender: ModuleType, addon: ModuleType) -> None:
    with pytest.raises(RuntimeError, match="import cameras first"):
        blender.ops.roigs.refine_cameras()


def test_what_it_asks_of_the_engine(blender: ModuleType, scene, tmp_path: Path) -> None:
    from roigs_addon.jobs import refine_job

    project = tmp_path / "garden"
    asked = refine_job.spec(scene).arguments
    assert asked == [
        *("refine-cameras", str(project)),
        *("--out", str(project / "sparse" / "refined")),
    ]
    assert refine_job.packages(scene) == FOR_REFINING
    scene.roigs.images = str(tmp_path / "photos")
    assert refine_job.spec(scene).arguments == [*asked, "--images", str(tmp_path / "photos")]


def test_it_shows_its_progress_and_can_be_stopped(
    blender: ModuleType, scene, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current, refine_job

    engine = fake(
        tmp_path,
        """
        say(event="progress", stage="refine cameras", step=1, total=2, seconds_left=9)
        sys.stdin.read()
        say(event="done", outputs={}, stopped=True)
        sys.exit(3)
        """,
    )
    job = current.start(engine, refine_job.spec(scene))
    assert until(lambda: job.poll() and current.state().step == 1)
    assert "Step 1 of 2" in panel(blender)
    assert not blender.ops.roigs.refine_cameras.poll()
    blender.ops.roigs.stop()
    assert current.wait(job).stopped
    assert scene.roigs.colmap == str(tmp_path / "garden") and not current.state().error
    assert blender.ops.roigs.refine_cameras.poll()


def test_the_scene_may_be_gone(blender: ModuleType, scene, tmp_path: Path) -> None:
    from roigs_addon.jobs import current, refine_job

    job = current.start(
        fake(tmp_path, "say(event='done', outputs={'model': 'x'})"), refine_job.spec(scene)
    )
    blender.ops.wm.read_homefile(use_empty=True)
    result = current.wait(job)
    assert result.message.startswith("The scene is gone. Import its refined cameras from")
    assert not blender.context.scene.roigs.colmap
