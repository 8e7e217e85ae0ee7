"""Photos: the engine makes a COLMAP project, which is imported."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.engine.folders import write
from tests.addon.fake_engine import alive, fake, until, use
from tests.addon.other_blender import engine_pid, other_blender
from tests.addon.photo_cases import is_shown, panel, photos_in, refusal
from tests.addon.scenes import ROOT
from tests.machine_load import Waited

pytestmark = pytest.mark.blender

BLENDER_SCRIPT = """
import sys
sys.path.insert(0, {root!r})
import bpy, roigs_addon
bpy.ops.wm.read_factory_settings(use_empty=True)
roigs_addon.register()
from roigs_addon.jobs import current
start = current.start
def noted(engine, spec):
    job = start(engine, spec)
    bpy.ops.wm.save_as_mainfile(filepath={blend!r})
    print("PID", spec.title, job.process.pid, flush=True)
    return job
current.start = noted
bpy.ops.roigs.reconstruct(photos={photos!r})
roigs_addon.unregister()
"""


def test_photos_become_a_scene(
    blender: ModuleType, reconstructing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.jobs import undo
    from roigs_addon.scene import lookup

    steps: list[str] = []
    monkeypatch.setattr(undo, "push", steps.append)
    bpy, scene = blender, reconstructing
    photos = photos_in(tmp_path / "ein Garten", 6)
    (photos / "notes.jpg").write_text("No photo.")
    before = {path: path.stat().st_mtime_ns for path in photos.iterdir()}
    assert bpy.ops.roigs.reconstruct(photos=str(photos)) == {"FINISHED"}
    project = tmp_path / "ein Garten_colmap"
    assert (scene.roigs.photos, scene.roigs.project) == (str(photos), str(project))
    assert scene.roigs.colmap == str(project) and steps == ["Reconstructing"]
    assert len(lookup.cameras(scene)) == 6 and lookup.points(scene)
    assert {path: path.stat().st_mtime_ns for path in photos.iterdir()} == before
    said = panel(bpy)
    assert "6 of 6 photos registered" in said and "1 photo cannot be read" in said
    assert is_shown(bpy)
    assert bpy.ops.roigs.show_reconstruction() == {"FINISHED"}
    (text,) = bpy.data.texts
    assert "| photos registered | 6 of 6 |" in text.as_string()


def test_what_was_stopped_resumes(blender: ModuleType, reconstructing, tmp_path: Path) -> None:
    from roigs_addon import settings
    from roigs_addon.engine.python import FOR_RECONSTRUCTING
    from roigs_addon.jobs import current, reconstruct_job

    scene, project = reconstructing, tmp_path / "garden_colmap"
    scene.roigs.photos = str(photos_in(tmp_path / "garden", 6))
    blend = tmp_path / "a.blend"
    job = current.start(settings.engine(FOR_RECONSTRUCTING), reconstruct_job.spec(scene))
    blender.ops.wm.save_as_mainfile(filepath=str(blend))
    assert until(lambda: not job.poll() or current.state().stage == "features", 60)
    waited = Waited()
    assert blender.ops.roigs.stop() == {"FINISHED"}
    assert until(lambda: not job.poll(), 30) and waited.at_most(2)
    assert job.result.stopped and not current.state().error and not scene.roigs.colmap
    assert (project / "reconstruction" / "state.json").is_file()

    blender.ops.wm.open_mainfile(filepath=str(blend))
    scene = blender.context.scene
    assert scene.roigs.project == str(project)
    assert "Continue" in panel(blender) and "Stopped before the end" in panel(blender)
    assert blender.ops.roigs.reconstruct() == {"FINISHED"}
    assert scene.roigs.colmap == str(project)
    assert "6 of 6 photos registered" in panel(blender) and "Continue" not in panel(blender)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_killed_blender_is_continued(blender: ModuleType, reconstructing, tmp_path: Path) -> None:
    photos, blend = photos_in(tmp_path / "garden", 6), tmp_path / "a.blend"
    values = {"root": str(ROOT), "blend": str(blend), "photos": str(photos)}
    events = tmp_path / "garden_colmap" / "reconstruction" / "events.jsonl"
    with other_blender(tmp_path, BLENDER_SCRIPT.format(**values)) as process:
        pid = engine_pid(process, "Reconstructing")
        assert until(lambda: events.is_file() and '"features"' in events.read_text(), 60)
        assert alive(pid)
        process.kill()
    assert until(lambda: not alive(pid), 5)
    blender.ops.wm.open_mainfile(filepath=str(blend))
    assert "Continue" in panel(blender)
    assert blender.ops.roigs.reconstruct() == {"FINISHED"}
    assert "6 of 6 photos registered" in panel(blender)


def test_photos_of_which_none_was_placed(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """Also when the file is opened again: there is a report, but no model."""
    (tmp_path / "garden").mkdir()
    project = tmp_path / "garden_colmap"
    write(project / "reconstruction" / "state.json", '{"done": null}')
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "garden"))
    assert "Stopped before the end" in panel(blender)
    write(project / "reconstruction.md", "# Reconstruction\n\nNo two photos could be registered.\n")
    said = panel(blender)
    assert "No two photos could be registered." in said and "Stopped" not in said
    assert blender.ops.roigs.show_reconstruction.poll()


def test_what_it_asks_of_the_engine(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.jobs import reconstruct_job

    (tmp_path / "garden").mkdir()
    props = blender.context.scene.roigs
    props.photos = str(tmp_path / "garden")
    asked = [
        *("reconstruct", str(tmp_path / "garden"), "--out", str(tmp_path / "garden_colmap")),
        *("--max-side", "1600", "--pairs", "auto", "--cameras", "auto"),
    ]
    assert reconstruct_job.spec(blender.context.scene).arguments == asked
    props.feature_side, props.pairs, props.shared_cameras = 800, "ordered", "one"
    asked[5::2] = ["800", "ordered", "one"]
    monkeypatch.setattr(settings, "get", lambda: settings.Settings(threads=1))
    asked += ["--threads", "1"]
    assert reconstruct_job.spec(blender.context.scene).arguments == asked


def test_masks_beside_the_photos_are_used(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.jobs import reconstruct_job

    def asked() -> list[str]:
        return reconstruct_job.spec(blender.context.scene).arguments

    def shown() -> str:
        return panel(blender).replace(" ", "")  # long lines are wrapped

    (tmp_path / "garden").mkdir()
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "garden"))
    props, beside = blender.context.scene.roigs, tmp_path / "masks"
    assert "--masks" not in asked() and str(beside) not in shown()
    beside.mkdir()
    assert asked()[-2:] == ["--masks", str(beside)] and str(beside) in shown()
    props.masks = str(tmp_path / "mine")
    assert asked()[-2:] == ["--masks", props.masks]
    blender.ops.roigs.choose_photos(directory=str(tmp_path))
    assert not props.masks


def test_the_options_are_the_engines(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_engine.requests.projects import ReconstructionMethod

    props, default = blender.context.scene.roigs, ReconstructionMethod()
    ours = props.feature_side, props.pairs, props.shared_cameras
    assert ours == (default.max_side, default.pairs, default.cameras)


def test_it_shows_its_progress_and_can_be_stopped(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current, reconstruct_job

    (tmp_path / "garden").mkdir()
    scene = blender.context.scene
    scene.roigs.photos = str(tmp_path / "garden")
    engine = fake(
        tmp_path,
        """
        say(event="progress", stage="matching", step=7, total=66, seconds_left=9)
        say(event="message", text="Two photos are small", level="warning")
        sys.stdin.read()
        say(event="done", outputs={}, stopped=True)
        sys.exit(3)
        """,
    )
    job = current.start(engine, reconstruct_job.spec(scene))
    assert until(lambda: job.poll() and bool(current.state().warnings))
    said = panel(blender)
    assert "Pair 7 of 66" in said and "Two photos are small" in said
    assert not blender.ops.roigs.reconstruct.poll() and not blender.ops.roigs.choose_photos.poll()
    blender.ops.roigs.stop()
    assert current.wait(job).stopped and not scene.roigs.colmap
    assert blender.ops.roigs.reconstruct.poll()


def test_drawing_the_panel_again_does_not_read_the_disk(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.engine import reconstruction
    from roigs_addon.facts import reconstructions, run_facts

    reads: list[Path] = []
    read = reconstruction.read
    monkeypatch.setattr(reconstruction, "read", lambda f: reads.append(f) or read(f))
    # As in a window; in background mode everything is looked at again.
    monkeypatch.setattr(reconstructions, "is_old", lambda fact: fact is None)
    assert run_facts.is_old(None)
    (tmp_path / "garden").mkdir()
    blender.context.scene.roigs.photos = str(tmp_path / "garden")
    for _ in range(5):
        panel(blender)
    assert len(reads) == 1


def test_errors_are_one_line(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "garden").mkdir()
    code = "say(event='failed', message='X is full.', hint='Give another --out.')\nsys.exit(2)"
    use(monkeypatch, tmp_path, code)
    assert refusal(blender) == "Choose the folder of the photos first."
    gone = str(tmp_path / "gone")
    assert refusal(blender, photos=gone).startswith(f"There is no folder {gone}")
    said = refusal(blender, photos=str(tmp_path / "garden"))
    assert said == "X is full. Give another Project Folder."
    assert "X is full." in panel(blender)


def test_the_scene_may_be_gone(blender: ModuleType, addon: ModuleType, tmp_path: Path) -> None:
    from roigs_addon.jobs import current, reconstruct_job

    (tmp_path / "garden").mkdir()
    scene = blender.context.scene
    scene.roigs.photos = str(tmp_path / "garden")
    code = "say(event='done', outputs={'scene': 'x'})"
    job = current.start(fake(tmp_path, code), reconstruct_job.spec(scene))
    blender.ops.wm.read_homefile(use_empty=True)
    result = current.wait(job)
    assert result.message.startswith("The scene is gone. Import the model from")
    assert not blender.context.scene.roigs.colmap


def test_the_panel_is_for_photos(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """It is hidden with a COLMAP model from elsewhere."""
    assert is_shown(blender) and "Choose a folder of photos" in panel(blender)
    blender.ops.roigs.import_colmap(directory=str(project))
    assert not is_shown(blender)
    (tmp_path / "a.jpg").touch()
    assert blender.ops.roigs.choose_photos(filepath=str(tmp_path / "a.jpg")) == {"FINISHED"}
    assert blender.context.scene.roigs.photos == str(tmp_path) and is_shown(blender)
    assert "Not reconstructed yet" in panel(blender)
