"""Run folders: what outlives the extension, and which run a folder belongs to."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import add_box, imported
from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender
UNWRITABLE = "(Cannot write|cannot be created or written to) .*Run Folder"


def test_runs_of_unsaved_files_outlive_the_extension(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.jobs import run_folders

    extension = tmp_path / ".user" / "roigs"
    monkeypatch.setattr(settings, "ADDON", "bl_ext.user_default.roigs")
    monkeypatch.setattr(blender.utils, "extension_path_user", lambda _: str(extension))
    run = run_folders.run_folder(blender.context.scene)
    assert not run.is_relative_to(extension)
    assert run.is_relative_to(blender.utils.user_resource("DATAFILES"))
    shared, earlier = settings.environments()
    assert not shared.is_relative_to(extension)
    assert earlier.is_relative_to(extension)
    assert settings.models_folder().is_relative_to(extension)
    assert not extension.exists()


def boxed(bpy: ModuleType, project: Path):
    """The scene, ready for a job, in a file without a name."""
    scene = imported(bpy, project)
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    return scene


def use(scene) -> Path:
    """Do to the run folder what a job does; returns it."""
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    return options_files.write_select_options(scene, lookup.rois(scene)).parents[1]


def save(bpy: ModuleType, path: Path, **options: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def opened(bpy: ModuleType, path: Path) -> Path:
    """The run folder of a file's scene."""
    from roigs_addon.jobs import run_folders

    bpy.ops.wm.open_mainfile(filepath=str(path))
    return run_folders.run_folder(bpy.context.scene)


def test_two_unsaved_files_of_one_project_have_two_folders(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import run_folders

    first = use(boxed(blender, project))
    save(blender, tmp_path / "a.blend")
    assert run_folders.run_folder(blender.context.scene) == first
    blender.ops.wm.read_homefile(use_empty=True)
    second = use(boxed(blender, project))
    assert first != second == run_folders.run_folder(blender.context.scene)
    assert use(blender.context.scene) == second
    save(blender, second.parents[2] / "home.blend")
    save(blender, tmp_path / "b.blend")
    assert opened(blender, second.parents[2] / "home.blend") == second
    shutil.move(second.parents[2] / "home.blend", tmp_path / "moved.blend")
    assert opened(blender, tmp_path / "moved.blend") == second
    assert opened(blender, tmp_path / "a.blend") == first


def test_a_run_after_the_first_save_goes_beside_the_file(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """Though photos were selected before; until something is trained."""
    from roigs_addon.jobs import run_folders
    from roigs_addon.scene import splats
    from roigs_engine.formats.run_files import MANIFEST

    scene = boxed(blender, project)
    before = use(scene)
    ply = random_ply(before / "blender" / "imported" / "vase.ply", 9)
    item = splats.show_imported(scene, ply, "vase", in_model=False)
    (before / "blender" / "selected").mkdir()
    save(blender, tmp_path / "g.blend")
    blender.ops.ed.undo_push(message="before")
    blender.ops.ed.undo_push(message="something")
    assert run_folders.run_folder(scene) == before
    folder = use(scene)
    assert folder == tmp_path / "g_roigs" == run_folders.run_folder(scene)
    assert (folder / "blender" / "selected").is_dir() and before.is_dir()
    assert Path(item.roigs.ply) == folder / "blender" / "imported" / "vase.ply"
    blender.ops.ed.undo()
    assert run_folders.run_folder(blender.context.scene) == folder
    # A run that was trained before stays where it is.
    blender.ops.wm.read_homefile(use_empty=True)
    before = use(boxed(blender, project))
    (before / MANIFEST).touch()
    save(blender, tmp_path / "h.blend")
    assert use(blender.context.scene) == before


def test_relative_paths_lead_to_the_same_place_after_save_as(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    def full() -> dict[str, str]:
        props = bpy.context.scene.roigs
        return {name: str(full_path(getattr(props, name))) for name in given}

    from roigs_addon.blender import full_path

    bpy, given = blender, {"photos": "//pictures/", "project": "//model", "masks": "//../masks"}
    given |= {"images": "//small", "colmap": "//model/sparse"}
    props = bpy.context.scene.roigs
    save(bpy, tmp_path / "here" / "a.blend")
    for name, value in given.items():
        setattr(props, name, value)
    before = full()
    save(bpy, tmp_path / "here" / "b.blend")
    assert {name: getattr(props, name) for name in given} == given
    save(bpy, tmp_path / "copies" / "c.blend", copy=True)
    assert full() == before and props.masks == given["masks"]
    save(bpy, tmp_path / "d.blend")
    assert full() == before
    assert (props.photos, props.project, props.masks) == (
        "//here/pictures",
        "//here/model",
        "//masks",
    )
    for path in ("copies/c.blend", "here/b.blend", "d.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / path))
        assert full() == before


def test_two_scenes_of_a_file_have_two_folders(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import run_folders

    first, second = boxed(blender, project), blender.data.scenes.new("zweite Szene")
    second.roigs.colmap = first.roigs.colmap
    save(blender, tmp_path / "g.blend")
    proposed = [run_folders.run_folder(scene) for scene in (first, second)]
    assert proposed == [tmp_path / "g_roigs", tmp_path / "g_zweite-Szene_roigs"]
    assert [run_folders.settle(scene) for scene in (second, first)] == proposed[::-1]
    copy = first.copy()
    with pytest.raises(AddonError, match=r"also uses the run folder"):
        run_folders.settle(copy)
    copy.roigs.run_dir = ""
    assert run_folders.settle(copy) not in proposed


def test_the_run_is_found_wherever_the_file_is_saved(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import run_folders

    home, scene = tmp_path / "home", boxed(blender, project)
    save(blender, home / "g.blend")
    run = use(scene)
    assert run == home / "g_roigs"
    save(blender, home / "g1.blend")
    (tmp_path / "away" / "g_roigs").mkdir(parents=True)  # another project's
    save(blender, tmp_path / "away" / "g.blend")
    save(blender, tmp_path / "copy.blend", copy=True)
    with pytest.raises(RuntimeError):
        blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "nowhere" / "g.blend"))
    assert run_folders.run_folder(scene) == run
    for path in ("home/g1.blend", "away/g.blend", "copy.blend"):
        assert opened(blender, tmp_path / path) == run, path
    # A folder that is moved takes its run with it.
    shutil.move(home, tmp_path / "moved")
    assert opened(blender, tmp_path / "moved" / "g1.blend") == tmp_path / "moved" / "g_roigs"


def test_a_relative_folder_of_the_users_own_stays_relative(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    settings = blender.context.scene.roigs
    save(blender, tmp_path / "a" / "g.blend")
    settings.run_dir = "//../runs/g"
    save(blender, tmp_path / "b" / "c" / "copy.blend", copy=True)
    assert settings.run_dir == "//../runs/g"
    save(blender, tmp_path / "b" / "c" / "g.blend")
    assert settings.run_dir == "//../../runs/g"
    for path in ("copy.blend", "g.blend"):
        assert opened(blender, tmp_path / "b" / "c" / path) == tmp_path / "runs" / "g"
    absolute = blender.context.scene.roigs.run_dir = str(tmp_path / "elsewhere")
    save(blender, tmp_path / "b" / "c" / "g.blend")
    opened(blender, tmp_path / "b" / "c" / "g.blend")
    assert blender.context.scene.roigs.run_dir == absolute


def test_a_run_folder_is_always_absolute(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that depends on where Blender was started, and one beside an unsaved .blend."""
    from roigs_addon.jobs import run_folders

    monkeypatch.chdir(tmp_path)
    scene = blender.context.scene
    for path in ("runs/g", "runs/../runs/g", "//runs/g"):
        scene.roigs.run_dir = path
        assert run_folders.run_folder(scene) == tmp_path / "runs" / "g", path


def test_an_undo_keeps_the_folder(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    from roigs_addon.jobs import run_folders

    scene = boxed(blender, project)
    blender.ops.ed.undo_push(message="before")
    blender.ops.ed.undo_push(message="something")
    run = use(scene)
    blender.ops.ed.undo()
    assert run_folders.run_folder(blender.context.scene) == run
    blender.ops.ed.redo()
    assert run_folders.run_folder(blender.context.scene) == run


def test_a_result_finds_its_scene_and_no_other(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import run_folders

    find = run_folders.finder(blender.context.scene)  # of an import
    blender.ops.ed.undo_push(message="before")
    blender.ops.ed.undo_push(message="something")
    blender.ops.ed.undo()
    blender.context.scene.name = "renamed"
    assert find() == blender.context.scene
    blender.ops.wm.read_homefile(use_empty=True)
    assert find() is None
    scene = boxed(blender, project)
    save(blender, tmp_path / "other.blend")
    save(blender, tmp_path / "g.blend")
    use(scene)
    find = run_folders.finder(scene)
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "other.blend"))
    assert find() is None, "the same model and the same name, but its own folder"
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "g.blend"))
    assert find() == blender.context.scene


@pytest.mark.skipif(sys.platform == "win32", reason="an unusable folder, the POSIX way")
def test_an_unusable_folder_gives_one_line(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.facts import run_facts
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    scene = boxed(blender, project)
    scene.roigs.run_dir = str(tmp_path / "run")
    (tmp_path / "run" / "blender").mkdir(parents=True)
    for name in ("rois.json", "train.json"):
        (tmp_path / "run" / "blender" / name).mkdir()
    for name in ("rois.json", "train.json"):
        with pytest.raises(
            AddonError, match=f"{UNWRITABLE}|was not written by this add-on.* Run Folder"
        ):
            options_files.write_train_options(scene, lookup.rois(scene), 0.0)
        (tmp_path / "run" / "blender" / name).rmdir()
    (tmp_path / "run" / "blender" / "selection").touch()
    lookup.rois(scene)[0].roigs.selection.add().name = "photo 0.png"
    with pytest.raises(AddonError, match=UNWRITABLE):
        options_files.write_train_options(scene, lookup.rois(scene), 0.0)
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file" / "run", tmp_path / ("x" * 300)):
        scene.roigs.run_dir = str(folder)
        assert not run_facts.run(scene).result and not run_facts.is_file(folder)


def test_an_unusable_cache_gives_one_line(
    blender: ModuleType,
    addon: ModuleType,
    project: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from roigs_addon import settings
    from roigs_addon.jobs import run_folders

    (tmp_path / "file").touch()
    monkeypatch.setattr(settings, "_chosen_cache", lambda: tmp_path / "file" / "cache")
    assert run_folders.run_folder(blender.context.scene)
    with pytest.raises(RuntimeError, match=r"cannot be created or written to .*Cache Folder"):
        blender.ops.roigs.import_colmap(directory=str(project))


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_links_are_not_written_through(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.engine.own_files import log_file
    from roigs_addon.engine.process import _Log
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    scene, run = boxed(blender, project), tmp_path / "run"
    scene.roigs.run_dir = str(run)
    lookup.rois(scene)[0].roigs.selection.add().name = "photo 0.png"
    mine, nowhere = tmp_path / "mine", tmp_path / "nowhere"
    mine.write_text("mine")
    own = ("rois.json", "train.json", "selection/thing.json", "engine.log")
    for name in own:
        (run / "blender" / name).parent.mkdir(parents=True, exist_ok=True)
        (run / "blender" / name).symlink_to(mine)
    for name in ("selection/thing.json", "train.json"):  # in the order in which they are written
        with pytest.raises(AddonError, match=f"{name} was not written by this add-on"):
            options_files.write_train_options(scene, lookup.rois(scene), 0.0)
        (run / "blender" / name).unlink()
        (run / "blender" / name).symlink_to(nowhere)
    options_files.write_train_options(scene, lookup.rois(scene), 0.0)
    log = _Log(log_file(run))
    log.write("a line")
    log.close()
    assert mine.read_text() == "mine" and not nowhere.exists()
    assert not any((run / "blender" / name).is_symlink() for name in own)
    shutil.rmtree(run)
    run.mkdir()
    (run / "blender").symlink_to(tmp_path)
    for write in (
        lambda: options_files.write_train_options(scene, lookup.rois(scene), 0.0),
        lambda: options_files.write_select_options(scene, lookup.rois(scene)),
    ):
        with pytest.raises(AddonError, match="is a link"):
            write()
