"""Photos: which folders are taken, which are refused, and where the project goes."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.photo_cases import panel, photos_in, refusal

pytestmark = pytest.mark.blender


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
    assert "was not created by this command. Give another Project Folder." in said
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
