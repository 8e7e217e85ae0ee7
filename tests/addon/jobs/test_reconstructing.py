"""Photos: the engine makes a COLMAP project, which is imported."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.engine.test_run_status import write
from tests.addon.fake_engine import alive, fake, until
from tests.addon.jobs.test_deaths import engine_pid, other_blender
from tests.addon.jobs.test_refining import use
from tests.addon.scenes import ROOT

pytestmark = pytest.mark.blender

WIDE = ROOT / "demo" / "scene" / "images" / "wide"
SIDE = 320
"""px; small, so that a test takes seconds."""


def photos_in(folder: Path, count: int) -> Path:
    """A folder with some of the demo's photos, neighbours of one another."""
    folder.mkdir(parents=True)
    for path in sorted(WIDE.iterdir())[:count]:
        shutil.copyfile(path, folder / path.name)
    return folder


def panel(bpy: ModuleType) -> str:
    from roigs_addon.ui.reconstruct import PhotosPanel
    from tests.addon.ui.test_panels import said

    return " ".join(said(bpy, PhotosPanel))


def is_shown(bpy: ModuleType) -> bool:
    from roigs_addon.ui.reconstruct import PhotosPanel

    return PhotosPanel.poll(bpy.context)


def refusal(bpy: ModuleType, **values: str) -> str:
    """The error of a reconstruction that fails; one line."""
    with pytest.raises(RuntimeError) as error:
        bpy.ops.roigs.reconstruct(**values)
    text = str(error.value).strip().removeprefix("Error: ")
    assert "\n" not in text and "Traceback" not in text
    return text


@pytest.fixture
def reconstructing(addon: ModuleType, blender: ModuleType):
    """The scene, with small photos; skips where no engine can reconstruct."""
    from roigs_addon import settings
    from roigs_addon.engine.python import FOR_RECONSTRUCTING
    from roigs_addon.errors import AddonError

    try:
        settings.engine(FOR_RECONSTRUCTING)
    except AddonError as error:
        pytest.skip(str(error))
    scene = blender.context.scene
    scene.roigs.feature_side = SIDE
    return scene


def test_photos_become_a_scene(
    blender: ModuleType, reconstructing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.jobs import undo
    from roigs_addon.scene import lookup

    steps: list[str] = []
    monkeypatch.setattr(undo, "push", steps.append)
    bpy, scene = blender, reconstructing
    photos = photos_in(tmp_path / "ein Garten", 12)
    (photos / "notes.jpg").write_text("No photo.")
    before = {path: path.stat().st_mtime_ns for path in photos.iterdir()}
    assert bpy.ops.roigs.reconstruct(photos=str(photos)) == {"FINISHED"}
    project = tmp_path / "ein Garten_colmap"
    assert (scene.roigs.photos, scene.roigs.project) == (str(photos), str(project))
    assert scene.roigs.colmap == str(project) and steps == ["Reconstructing"]
    assert len(lookup.cameras(scene)) == 12 and lookup.points(scene)
    assert {path: path.stat().st_mtime_ns for path in photos.iterdir()} == before
    said = panel(bpy)
    assert "12 of 12 photos registered" in said and "1 photo cannot be read" in said
    assert is_shown(bpy)
    assert bpy.ops.roigs.show_reconstruction() == {"FINISHED"}
    (text,) = bpy.data.texts
    assert "| photos registered | 12 of 12 |" in text.as_string()


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
    asked = time.monotonic()
    assert blender.ops.roigs.stop() == {"FINISHED"}
    assert until(lambda: not job.poll(), 30) and time.monotonic() - asked < 2
    assert job.result.stopped and not current.state().error and not scene.roigs.colmap
    assert (project / "reconstruction" / "state.json").is_file()

    blender.ops.wm.open_mainfile(filepath=str(blend))
    scene = blender.context.scene
    assert scene.roigs.project == str(project)
    assert "Continue" in panel(blender) and "Stopped before the end" in panel(blender)
    assert blender.ops.roigs.reconstruct() == {"FINISHED"}
    assert scene.roigs.colmap == str(project)
    assert "6 of 6 photos registered" in panel(blender) and "Continue" not in panel(blender)


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


def test_photos_that_cannot_be_used_are_one_line(
    blender: ModuleType, reconstructing, tmp_path: Path
) -> None:
    bpy = blender
    (tmp_path / "empty").mkdir()
    assert "has no photos" in refusal(bpy, photos=str(tmp_path / "empty"))
    one = photos_in(tmp_path / "one", 1)
    said = refusal(bpy, photos=str(one))
    assert "at least two different photos; 1 can be used" in said and said in panel(bpy)
    (photo,) = one.iterdir()
    for number in range(40):
        shutil.copyfile(photo, one / f"copy {number}.jpg")
    assert "(0 unreadable, 40 copies)" in refusal(bpy, photos=str(one))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.jpg").write_text("No photo.")
    assert "0 can be used (1 unreadable" in refusal(bpy, photos=str(tmp_path / "notes"))
    two = photos_in(tmp_path / "two", 2)
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    said = refusal(bpy, photos=str(two), project=str(in_the_way / "scene"))
    assert "Cannot write" in said and "choose another folder" in said


def test_the_folders_of_others_are_left(
    blender: ModuleType, reconstructing, project: Path, tmp_path: Path
) -> None:
    photos = photos_in(tmp_path / "garden", 2)
    copy = tmp_path / "theirs"
    shutil.copytree(project, copy)
    said = refusal(blender, photos=str(photos), project=str(copy))
    assert "has a model already" in said and "another Project Folder" in said and "--" not in said
    shutil.rmtree(copy / "sparse")
    (copy / "database.db").write_text("theirs")
    said = refusal(blender, project=str(copy))
    assert "is not of this command. Give another Project Folder." in said
    assert (copy / "database.db").read_text() == "theirs"
    assert not (copy / "reconstruction").exists()


def test_where_the_project_goes(addon: ModuleType, tmp_path: Path) -> None:
    from roigs_addon.jobs.reconstruct_job import proposed

    garden = tmp_path / "garden"
    assert proposed(garden) == tmp_path / "garden_colmap"
    assert proposed(garden / "images") == garden / "garden_colmap"
    (tmp_path / "garden_colmap" / "mine").mkdir(parents=True)
    assert proposed(garden) == tmp_path / "garden_colmap-2"
    (tmp_path / "garden_colmap-2" / "reconstruction").mkdir(parents=True)
    assert proposed(garden) == tmp_path / "garden_colmap-2"


def test_photos_of_which_none_was_placed(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """Also when the file is opened again: there is a report, but no model."""
    (tmp_path / "garden").mkdir()
    project = tmp_path / "garden_colmap"
    write(project / "reconstruction" / "state.json", '{"done": null}')
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "garden"))
    assert "Stopped before the end" in panel(blender)
    write(project / "reconstruction.md", "# Reconstruction\n\nNo two photos could be placed.\n")
    said = panel(blender)
    assert "No two photos could be placed." in said and "Stopped" not in said
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
    from roigs_addon import properties
    from roigs_engine.reconstruction.settings import CAMERAS, PAIRS, Settings

    assert tuple(item[0] for item in properties.PAIRS) == PAIRS
    assert tuple(item[0] for item in properties.SHARED_CAMERAS) == CAMERAS
    props, default = blender.context.scene.roigs, Settings()
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


def test_other_photos_get_another_project(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    props = blender.context.scene.roigs
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "one"))
    props.project = str(tmp_path / "elsewhere")
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "one"))
    assert props.project == str(tmp_path / "elsewhere")
    blender.ops.roigs.choose_photos(directory=str(tmp_path / "two"))
    assert not props.project


def test_dropped_photos_bring_their_folder(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.operators.drop import PhotosHandler

    files = [{"name": "a.jpg"}, {"name": "b.jpg"}]
    assert blender.ops.roigs.drop_photos(directory=str(tmp_path), files=files) == {"FINISHED"}
    assert blender.context.scene.roigs.photos == str(tmp_path)
    assert not PhotosHandler.poll_drop(blender.context)  # no 3D view here


def test_the_handler_takes_photos_that_the_engine_reads(addon: ModuleType) -> None:
    from roigs_addon.operators.drop import PhotosHandler
    from roigs_engine.formats.projects import VIDEOS
    from roigs_engine.photos.files import EXTENSIONS, HEIC

    assert set(PhotosHandler.bl_file_extensions.split(";")) <= EXTENSIONS | HEIC | VIDEOS


def test_a_video_is_taken_like_a_folder_of_photos(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    from roigs_addon.jobs import reconstruct_job

    walk, props = tmp_path / "a walk.MP4", blender.context.scene.roigs
    walk.touch()
    inside = {"directory": f"{tmp_path}{os.sep}", "filepath": str(walk)}
    assert blender.ops.roigs.choose_photos(**inside) == {"FINISHED"}
    assert props.photos == str(walk) and "Not reconstructed yet" in panel(blender)
    asked = reconstruct_job.spec(blender.context.scene).arguments
    assert asked[:4] == ["reconstruct", str(walk), "--out", str(tmp_path / "a walk_colmap")]
    props.photos = ""
    blender.ops.roigs.drop_photos(directory=str(tmp_path), files=[{"name": walk.name}])
    assert props.photos == str(walk)


def test_folders_beside_a_blend_that_was_never_saved(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """They had become folders where Blender was started."""
    props = blender.context.scene.roigs
    photos = str(photos_in(tmp_path / "photos", 2))
    assert "Save the .blend first" in refusal(blender, photos="//photos")
    assert "Save the .blend first" in refusal(blender, photos=photos, project="//project")
    assert (props.photos, props.project) == ("", "")
    props.photos, props.project = photos, "//project"  # typed into the panel
    assert "//project" in refusal(blender)
    panel(blender)  # still draws
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    blender.ops.roigs.choose_photos(directory="//photos")
    assert props.photos == photos
