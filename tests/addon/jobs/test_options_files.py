"""Options files of jobs, and reasons why one cannot be written."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import options, ready

pytestmark = pytest.mark.blender


def test_errors_say_what_is_missing(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import options_files

    bpy, scene = blender, blender.context.scene
    for operator in (bpy.ops.roigs.select_cameras, bpy.ops.roigs.train_roi):
        assert not operator.poll()
    with pytest.raises(AddonError, match="There are no cameras"):
        options_files.common_options(scene, [])
    ready(bpy, project, tmp_path / "run")
    with pytest.raises(AddonError, match="no boxes"):
        options_files.common_options(scene, [])
    scene.roigs.colmap = str(tmp_path / "gone")
    with pytest.raises(RuntimeError, match="no longer exists"):
        bpy.ops.roigs.select_cameras()
    scene.roigs.colmap = str(project)
    (tmp_path / "file").touch()
    scene.roigs.run_dir = str(tmp_path / "file")
    with pytest.raises(RuntimeError, match="cannot be created"):
        bpy.ops.roigs.select_cameras()


def test_the_papers_preset_is_the_papers_way(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import options_files
    from roigs_addon.properties import USUAL_TARGET
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    settings, rois = scene.roigs, lookup.rois(scene)

    def asked() -> tuple[str, str, str]:
        options_files.write_train_options(scene, rois, 0.0)
        values = options(tmp_path / "run", "train")
        return values["strategy"], values["method"], values["made_for"]

    assert asked() == ("joint", "coverage", USUAL_TARGET)
    settings.preset = "paper"
    assert asked() == ("independent", "gp9", "plain")
    settings.preset = "standard"
    assert asked() == ("joint", "coverage", USUAL_TARGET)
    settings.method = "greedy"  # by hand: stays
    settings.preset = "paper"
    assert asked() == ("independent", "greedy", "plain")
    settings.strategy, settings.made_for = "joint", "viewers"
    settings.preset = "draft"
    assert asked() == ("joint", "greedy", "viewers")
    settings.made_for, settings.strategy = "plain", "independent"
    settings.preset = "standard"
    assert asked() == ("independent", "greedy", "plain")
    settings.preset = "paper"
    settings.preset = "standard"
    assert asked() == ("joint", "greedy", USUAL_TARGET)


@pytest.mark.parametrize("preset", ["draft", "standard", "paper"])
def test_the_presets_default_target_is_the_engines(
    blender: ModuleType, addon: ModuleType, preset: str
) -> None:
    """But where Blender has splats of its own, results are made for these."""
    from roigs_addon.properties import USUAL_TARGET
    from roigs_engine.run.presets import preset as of_engine

    assert ("cycles" if blender.app.version >= (5, 3, 0) else "viewers") == USUAL_TARGET

    settings = blender.context.scene.roigs
    settings.preset = "paper" if preset == "draft" else "draft"
    settings.preset = preset
    wanted = of_engine(preset).roi.made_for
    assert settings.made_for == (USUAL_TARGET if wanted == "viewers" else wanted)


def test_deleted_cameras_exclude_their_photos(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup
    from roigs_addon.ui.scene import ScenePanel
    from tests.addon.panels import said

    scene = ready(blender, project, tmp_path / "run")
    rois, cameras = lookup.rois(scene), lookup.cameras(scene)

    def asked() -> list[str]:
        options_files.write_train_options(scene, rois, 0.0)
        excluded: list[str] = options(tmp_path / "run", "train").get("exclude", [])
        return excluded

    assert asked() == [] and not any("excluded" in text for text in said(blender, ScenePanel))
    for name in ("photo 2.png", "photo 5.png"):
        blender.data.objects.remove(cameras[name])
    assert asked() == ["photo 2.png", "photo 5.png"]
    assert "2 photos excluded" in said(blender, ScenePanel)
    for camera in lookup.cameras(scene).values():
        blender.data.objects.remove(camera)
    with pytest.raises(AddonError, match="All photos are excluded"):
        asked()
    blender.ops.roigs.include_photos(every=True)
    assert asked() == [] and len(lookup.cameras(scene)) == 8


def test_numbers_reach_the_engine_as_given(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    scene.roigs.steps_factor, scene.roigs.max_side = 20.0, 32
    options_files.write_train_options(scene, lookup.rois(scene), 0.0)
    values = options(tmp_path / "run", "train")
    assert (values["steps_factor"], values["max_side"]) == (20.0, 32)


def test_rendering_works_where_training_does(
    blender: ModuleType, addon: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings
    from roigs_addon.jobs import options_files

    assert options_files.machine_options() == ["--device", "auto"]
    chosen = settings.Settings(device="cpu", threads=3)
    monkeypatch.setattr(settings, "get", lambda: chosen)
    assert options_files.machine_options() == ["--device", "cpu", "--threads", "3"]


def test_the_name_of_a_box_cannot_lead_elsewhere(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """A .blend may come from anybody and contain any names."""
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    roi = lookup.rois(scene)[0]
    roi.roigs.selection.add().name = "photo 0.png"
    for name in ("../../../out", str(tmp_path / "out"), "..\\out", ".."):
        roi.name = name
        with pytest.raises(AddonError, match="cannot name a file"):
            options_files.write_train_options(scene, [roi], 0.0)
        with pytest.raises(AddonError, match="cannot name a file"):
            options_files.write_select_options(scene, [roi])
    assert {path.name for path in tmp_path.iterdir()} <= {"run"}


def test_files_of_others_in_the_run_folder_stay(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """The user may have chosen a project of another program, with a folder `blender` in it."""
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    scene = ready(blender, project, tmp_path / "run")
    roi = lookup.rois(scene)[0]
    roi.roigs.selection.add().name = "photo 0.png"
    own = tmp_path / "run" / "blender"
    options_files.write_train_options(scene, [roi], 0.0)
    theirs = (
        own / "selection" / "notes.json",
        own / "selection" / "thing.json",
        own / "train.json",
    )
    gone = own / "selection" / "gone.json"
    gone.write_text('{"roi": "gone", "names": []}')
    theirs[0].write_text("[]")
    options_files.write_train_options(scene, [roi], 0.0)
    assert theirs[0].read_text() == "[]" and not gone.exists()
    for path in theirs[1:]:
        path.write_text('{"name": "mine"}')
        with pytest.raises(AddonError, match=f"{path.name} was not written by this add-on"):
            options_files.write_train_options(scene, [roi], 0.0)
        assert path.read_text() == '{"name": "mine"}'
        path.unlink()
